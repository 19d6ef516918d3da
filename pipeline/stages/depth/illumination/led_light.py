"""Light of distant LEDs, as the sensor description gives it or as fitted to a sensor instance.

    light = (R + g c(grad z)) s(z),    R: reference image,  c: colour change of a slope
                                       (`physics.optics`),
                                       s: share of the light that passes the surface,  g: gain of
                                                                                       near LEDs

The deviations of an instance from its description are (5 n + 5,): azimuth, elevation (degrees) and
the logarithm of each colour for each of n LEDs; then fall-off, vignette, the logarithms of blur and
of shadow strength, and the shadows' elevation (degrees).
"""

import math
from dataclasses import replace

import numpy as np

from pipeline.calibration import near_led_prior, slope_model
from pipeline.core.arrays import Doubles, Floats
from pipeline.core.frozen import frozen
from pipeline.physics.optics import apply_shadows, pack_leds, require_optics
from pipeline.sensors.parts import Led, Optics, compute_mean_reference_light
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import LIGHT, SURFACE
from pipeline.stages.depth.illumination.light import (
    ImagePatch,
    Light,
    RenderedChange,
    compute_cell_means,
)


@frozen
class LedLight(Light):
    """Distant LEDs over one patch."""

    optics: Optics  # that are rendered: fitted, or the source's own
    gain: Floats  # (rows, cols, 3) of the light over the described one; 1 but for near LEDs

    def render(self, surface_mm: Floats, gx: Floats, gy: Floats) -> RenderedChange:
        """Render the light of a surface (rows, cols) with these slopes."""
        from pipeline.stages.depth.illumination.illumination_kernels import (
            N_LINES,
            TILE_PX,
            render_led_light,
        )

        camera = self.source.camera
        patch = self.patch
        size = np.array([camera.cols, camera.rows], np.float32)
        place = (
            patch.x_px,
            patch.y_px,
            size,
            *pack_leds(self.optics, camera),
            np.float32(self.optics.vignette),
        )
        share = np.ones_like(patch.reference)
        if self.optics.shadow > 0:
            apply_shadows(
                share,
                self.optics,
                camera,
                np.ascontiguousarray(surface_mm, np.float32),
                patch.pixel_mm,
            )
        out = RenderedChange(*(np.empty_like(patch.change) for _ in range(3)))
        scratch = np.empty(N_LINES * TILE_PX, np.float32)
        render_led_light(gx, gy, place, (patch.reference, self.gain, share), scratch, *out)
        return out


def make_led_light(
    source: SensorSpec, optics: Optics, patch: ImagePatch, *, trusted: bool, near: bool = False
) -> LedLight:
    """Light of these optics of a sensor.

    `near` scales it by what LEDs close to the gel change of it.
    """
    return LedLight(
        source=source,
        optics=optics,
        patch=patch,
        step_rule=SURFACE.trusted_step if trusted else SURFACE.described_step,
        gain=_compute_near_gain(source, patch) if near else np.ones_like(patch.reference),
        blur_px=optics.blur_px,
    )


def compute_led_prior_root(described: Optics) -> Doubles:
    """A root (m, m) of the prior covariance of the deviations; a LED's colours vary together."""
    n_leds = len(described.leds)
    led = np.zeros((5, 5))
    led[0, 0] = LIGHT.azimuth_deg
    led[1, 1] = LIGHT.elevation_deg
    led[2:, 2:] = np.linalg.cholesky(LIGHT.log_colour**2 * np.eye(3) + LIGHT.log_power**2)
    m = 5 * n_leds
    root = np.diag(np.concatenate([np.zeros(m), LIGHT.others]))
    root[:m, :m] = np.kron(np.eye(n_leds), led)
    return root


def shift_optics(described: Optics, deviations: Doubles) -> Optics:
    """The optics that deviate by (m,) from the described ones."""
    n = len(described.leds)
    falloff, vignette, blur, shadow, shadow_deg = (float(v) for v in deviations[5 * n :])
    low, high = LIGHT.elevation_limits_deg
    return replace(
        described,
        leds=tuple(
            _shift_led(led, deviations[5 * k : 5 * k + 5]) for k, led in enumerate(described.leds)
        ),
        falloff=min(max(described.falloff + falloff, 0.0), 1.0),
        vignette=min(max(described.vignette + vignette, 0.0), 1.0),
        blur_px=described.blur_px * math.exp(blur),
        shadow=min(described.shadow * math.exp(shadow), 1.0),
        shadow_deg=min(max(described.shadow_deg + shadow_deg, low), high),
    )


def _shift_led(led: Led, deviations: Doubles) -> Led:
    red, green, blue = (float(v * s) for v, s in zip(led.rgb, np.exp(deviations[2:]), strict=True))
    low, high = LIGHT.elevation_limits_deg
    return Led(
        azimuth_deg=float(led.azimuth_deg + deviations[0]) % 360.0,
        elevation_deg=min(max(float(led.elevation_deg + deviations[1]), low), high),
        rgb=(red, green, blue),
    )


def _compute_near_gain(source: SensorSpec, patch: ImagePatch) -> Floats:
    """Gain of each colour's light (rows, cols, 3) over the described one.

    Paint, lens, exposure, and LEDs that light a part of the gel make a place bright, and its change
    strong as well; LEDs close to the gel change the colours' response to slopes besides
    (`near_led_prior.compute_gains`).
    """
    import cv2

    rows, cols = patch.changed.shape
    by = max(1, round(LIGHT.reference_blur_px / patch.downsampling))  # cells as wide as the blur
    cells = cv2.GaussianBlur(
        compute_cell_means(patch.reference, by),
        (0, 0),
        LIGHT.reference_blur_px / patch.downsampling / by,
    )
    offset = np.float32(slope_model.OFFSET_GREY)
    camera = source.camera
    usual = compute_mean_reference_light(camera, require_optics(source))
    table = near_led_prior.compute_gains(source) / (usual + offset)
    down, across = (
        _make_interpolation(
            (px[0] + (np.arange(n) * by + 0.5 * (by - 1)) * patch.downsampling) / (end - 1), m
        )
        for px, n, end, m in zip(
            (patch.y_px, patch.x_px), cells.shape, camera.shape, table.shape, strict=False
        )
    )
    gains = (cells + offset) * np.tensordot(down, np.tensordot(across, table, (1, 1)), (1, 1))
    wide = (cells.shape[1] * by, cells.shape[0] * by)
    return np.ascontiguousarray(
        cv2.resize(gains, wide, interpolation=cv2.INTER_LINEAR)[:rows, :cols], np.float32
    )


def _make_interpolation(share: Floats, n: int) -> Floats:
    """The matrix (m, n) that interpolates `n` values linearly at shares (m,) of the way from the
    first to the last.
    """
    return np.maximum(
        0.0, 1.0 - np.abs(np.clip(share, 0.0, 1.0)[:, None] * (n - 1) - np.arange(n))
    ).astype(np.float32)
