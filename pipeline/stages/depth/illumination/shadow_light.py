"""Light of low LEDs of which shading and shadow take the light only once.

The described light shades a slope by one elevation and casts shadows by another, lower one, and removes both from the
same light: a sloped pixel in a shadow loses more light than reaches it. On a real DIGIT the shadow is as long and as
dark as the shading is strong. Here

    light = (R + R0) (1 + sum_n share_n (facing_n(grad z) visible_n(z) - 1)),    facing = max(0, l . n) / l_z,

with R the reference image, share_n (3,) what LED n gives of each colour on level gel, and visible_n how much of it
passes the surface at the LED's one elevation. The rest is scattered light that no dent changes.

The deviations of an instance are (5 n,) for n LEDs: azimuths (rad), logarithms of the elevations' tangents, shares.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.sensors.parts import compute_mean_reference_light
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination.constants import SHADOW_STEP
from pipeline.stages.depth.illumination.light import ImagePatch, Light, RenderedChange

_DARK_GREY = np.float32(2.0)  # R0: a camera's black is not quite none
_NOISE_PER_GREY = np.float32(0.01)  # noise grows with the light
_MAX_DEPTH_FACTOR = 2.0  # of the sensor's largest indentation, on the way to a surface
# Standard deviations between sensor instances and places: azimuth, log tangent of the elevation, share of a LED's own
# colour and of the other colours. Presses of one ball on a real DIGIT, with their shape given, show azimuths up to 15
# degrees and shares of other colours up to 0.15 from the mean.
_AZIMUTH_RAD, _LOG_TANGENT, _OWN_SHARE, _OTHER_SHARE = math.radians(15.0), 0.12, 0.15, 0.15
_FIXED_MEAN_HEIGHT = 1e6  # precision of the mean log tangent: one touch trades it with its own size
_SHARE_LIMITS = (-0.3, 0.9)
_OWN_COLOUR = 0.5  # of the largest share


@dataclass(frozen=True, slots=True, kw_only=True)
class LedArray:
    """LEDs that stand low next to the gel."""

    azimuth_rad: Doubles  # (n,)
    elevation_rad: Doubles  # (n,)
    colour_share: Doubles  # (3, n) of each colour's light on level gel

    @property
    def directions(self) -> Floats:
        """Unit vectors (n, 3) toward the LEDs."""
        flat = np.cos(self.elevation_rad)
        parts = [flat * np.cos(self.azimuth_rad), flat * np.sin(self.azimuth_rad), np.sin(self.elevation_rad)]
        return np.stack(parts, axis=1).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowLight(Light):
    """Low LEDs over one patch."""

    leds: LedArray

    def render(self, surface_mm: Floats, gx: Floats, gy: Floats) -> RenderedChange:
        """Render the light of a surface (rows, cols) with these slopes."""
        from pipeline.stages.depth.illumination.illumination_kernels import render_shadow_light

        out = RenderedChange(*(np.empty_like(self.patch.change) for _ in range(3)))
        level = self.patch.reference + _DARK_GREY
        share = np.ascontiguousarray(self.leds.colour_share, np.float32)
        visible = compute_visibility(self.leds, surface_mm, self.patch.pixel_mm)
        render_shadow_light(gx, gy, level, visible, self.leds.directions, share, *out)
        return out


def make_shadow_light(source: SensorSpec, leds: LedArray, patch: ImagePatch) -> ShadowLight:
    """Light of low LEDs; noise is a share of the light, plus what the camera adds."""
    noise = np.hypot(1.0, _NOISE_PER_GREY * (patch.reference + patch.change))
    return ShadowLight(
        source=source, patch=patch, leds=leds, step_rule=SHADOW_STEP,
        confidence=np.asarray(patch.unmarked_share / noise, np.float32),
        blur_px=optics.require_optics(source).blur_px,
        max_depth_mm=_MAX_DEPTH_FACTOR * source.limits.indentation_max_mm,
    )  # fmt: skip


def compute_visibility(leds: LedArray, surface_mm: Floats, pixel_mm: float) -> Floats:
    """The share of each LED's light (n, rows, cols) that passes the surface."""
    covers = optics.iterate_led_shadows(surface_mm, leds.directions[:, :2], np.tan(leds.elevation_rad), pixel_mm)
    return np.stack([1.0 - cover for cover in covers])


def make_described_leds(source: SensorSpec) -> LedArray:
    """LEDs that change the grey levels as much by a slope and by a shadow as the described optics do."""
    described = optics.require_optics(source)
    rgb = np.array([led.rgb for led in described.leds]).T  # (3, n)
    share = described.shadow * rgb / np.maximum(rgb.sum(axis=1, keepdims=True), 1e-6)
    usual = compute_mean_reference_light(source.camera, described)
    up = np.radians([led.elevation_deg for led in described.leds])
    by_slope = (rgb * np.cos(up) / (1.0 - np.sin(up)) * (1.0 - 0.5 * described.falloff)).max(axis=0)  # grey per mm/mm
    own = rgb.argmax(axis=0), range(len(up))
    return LedArray(
        azimuth_rad=np.radians([led.azimuth_deg for led in described.leds]),
        elevation_rad=np.arctan(share[own] * usual[own[0]] / by_slope),
        colour_share=share,
    )


def compute_shadow_prior_root(described: LedArray) -> Doubles:
    """A root (m, m) of the prior covariance of the deviations."""
    n = len(described.azimuth_rad)
    own = described.colour_share > _OWN_COLOUR * described.colour_share.max()
    spread = np.concatenate(
        [np.full(n, _AZIMUTH_RAD), np.full(n, _LOG_TANGENT), np.where(own, _OWN_SHARE, _OTHER_SHARE).ravel()]
    )
    precision = np.diag(1.0 / spread**2)
    precision[n : 2 * n, n : 2 * n] += _FIXED_MEAN_HEIGHT
    return np.asarray(np.linalg.cholesky(np.linalg.inv(precision)), np.float64)


def shift_leds(described: LedArray, deviations: Doubles) -> LedArray:
    """The LEDs that deviate by (m,) from the described ones."""
    n = len(described.azimuth_rad)
    return replace(
        described,
        azimuth_rad=described.azimuth_rad + deviations[:n],
        elevation_rad=np.arctan(np.tan(described.elevation_rad) * np.exp(deviations[n : 2 * n])),
        colour_share=np.clip(described.colour_share + deviations[2 * n :].reshape(3, n), *_SHARE_LIMITS),
    )
