"""Prior of a sensor instance's light before any touch: LEDs close to the gel, as in all instances
that can be built.

A sensor's description has distant LEDs. In a real instance they stand a few millimetres next to the
image: close to a LED its light falls steeply and hardly shades slopes, far from it at a glancing
angle, and its beam meets the gel somewhere. Instances are sampled with LEDs of the described side,
elevation (at the image centre) and colour, at random distances and beams, alike for the LEDs of one
instance; light that no slope changes is added. The mean and covariance of their fields, widened by
a smooth misfit, are the prior of `shading_field`. The ranges are those of such LEDs; the misfit is
the one that does best on simulated instances of distant LEDs, with light of their own where they
are pressed.
"""

from collections.abc import Callable

import numpy as np

from pipeline.calibration import slope_model
from pipeline.calibration.shading_field import (
    N_POSITION_TERMS,
    N_SHADING_TERMS,
    ShadingFieldPrior,
    compute_position_terms,
)
from pipeline.core import disk_store
from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.physics.optics import compute_colour_change, require_optics
from pipeline.sensors.parts import compute_mean_reference_light
from pipeline.sensors.spec import Optics, SensorSpec

_N_INSTANCES = 1200
_GRID = (11, 13)  # rows and columns of the places at which the light is computed
_STEP_MM = 0.1  # of the indentation, for the light's derivative
# standard deviations: of instances, of one LED
_AZIMUTH_DEG = 8.0
_ELEVATION_DEG = 8.0
_LED_ELEVATION_DEG = 3.0
_ELEVATIONS_DEG = (6.0, 70.0)
# of the LEDs from the centre, in distances to the image border
_NEAREST = 1.05
_DISTANCE = (1.1, 2.6)
_BEAM_WIDTH_DEG = (12.0, 50.0)
_FALLOFF_POWER = (0.0, 2.0)  # of the distance
_STRIP_DEG = (0.0, 25.0)  # a LED is three points this far apart, as seen from the centre
_LOG_POWER = 0.25  # standard deviation
_OTHER_COLOURS = 0.15  # largest share of the LED's own colour
_AMBIENT = (0.05, 1.0)  # light that no slope changes, in units of the LEDs' mean
# between colours, and over half of the image
_AMBIENT_SPREAD = 0.3
_AMBIENT_TILT = 0.3
# share of the field's size, and correlation length in halves of the image
_MISFIT = 0.2
_MISFIT_REACH = 0.7
_RIDGE = 1e-9
# beyond, a colour carries no information, or the median of instances rests on a few
_GAINS = (0.05, 3.0)
_SMALL_SLOPE = 1e-3  # mm/mm: the light is linear there
_CODE = (
    "pipeline.calibration.near_led_prior",
    "pipeline.calibration.shading_field",
    "pipeline.calibration.slope_model",
    "pipeline.physics.optics",
    "pipeline.physics.optics_kernels",
    "pipeline.sensors.parts",
)
_LEVEL_MISFIT = 0.3  # share of the misfit along z, where a tilt weakens all light alike


@derive_once
def compute_prior(sensor: SensorSpec, pixel_mm: float, shape: tuple[int, int]) -> ShadingFieldPrior:
    """The prior of `sensor`'s field over an image of `shape` (rows, cols).

    SettingProblem for one without optics.
    """
    optics = require_optics(sensor)
    return disk_store.load_or_make(
        ShadingFieldPrior,
        (optics, pixel_mm, shape),
        _CODE,
        lambda: _compute_prior(optics, pixel_mm, shape),
        "look_ups",
    )


def _compute_prior(optics: Optics, pixel_mm: float, shape: tuple[int, int]) -> ShadingFieldPrior:
    fields = sample_instances(optics, pixel_mm, shape, _N_INSTANCES, np.random.default_rng(0))
    mean = fields.mean(axis=0)
    flat = (fields - mean).reshape(_N_INSTANCES, -1)
    centre = mean.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)[:, 0, :2]
    size = float(np.linalg.norm(centre, axis=1).mean())
    covariance = flat.T @ flat / _N_INSTANCES + _compute_misfit(shape, size)
    return ShadingFieldPrior(mean=freeze(mean.ravel()), precision=freeze(np.linalg.inv(covariance)))


def sample_instances(
    optics: Optics, pixel_mm: float, shape: tuple[int, int], count: int, rng: np.random.Generator
) -> Doubles:
    """Fields (count, 3, N_POSITION_TERMS, N_SHADING_TERMS) of `count` random instances."""
    u, v = _grid(shape)
    half_mm = 0.5 * max(shape) * pixel_mm
    compute_light = _draw_leds(optics, u * half_mm, v * half_mm, count, rng)
    rgb = np.array([led.rgb for led in optics.leds])  # (LEDs, 3)
    spill = rng.uniform(0.0, _OTHER_COLOURS, (count, len(rgb), 1)) * rng.random(
        (count, len(rgb), 3)
    )
    rgb = (
        rgb * np.exp(rng.normal(0.0, _LOG_POWER, (count, 1, 3)))
        + spill * rgb.mean(axis=1)[None, :, None]
    )
    level = compute_light(0.0)
    rise = (compute_light(_STEP_MM)[..., 2:] - level[..., 2:]) / _STEP_MM
    change = np.einsum("nlpi,nlk->nkpi", np.concatenate([level, rise], axis=-1), rgb)
    still = np.einsum("nlp,nlk->nkp", level[..., 2], rgb)
    share = rng.uniform(*_AMBIENT, (count, 1)) * np.exp(
        rng.normal(0.0, _AMBIENT_SPREAD, (count, 3))
    )
    tilt = rng.normal(0.0, _AMBIENT_TILT, (2, count, 3, 1))
    ambient = (share * still.mean(axis=(1, 2))[:, None])[..., None] * np.exp(
        tilt[0] * u + tilt[1] * v
    )
    relative = (
        slope_model.SPAN_GREY * change / (still + ambient + slope_model.OFFSET_GREY)[..., None]
    )
    return np.einsum("cp,nkpi->nkci", np.linalg.pinv(compute_position_terms(u, v)), relative)


@frozen
class _Gains:
    table: Floats  # (rows, cols, 3)


@derive_once
def compute_gains(sensor: SensorSpec) -> Floats:
    """How strongly a slope changes the colours under near LEDs, in units of the described change.

    Needs optics.

    The median of random instances on a grid (rows, cols, 3) whose corners are the image's. Both
    changes are relative to the reference image: the instance's own at that place, and the mean of
    the described one.
    """
    made_of = (sensor.camera, sensor.optics, sensor.pixel_mm)
    return disk_store.load_or_make(
        _Gains, made_of, _CODE, lambda: _Gains(table=_compute_gain_table(sensor)), "look_ups"
    ).table


def _compute_gain_table(sensor: SensorSpec) -> Floats:
    described = require_optics(sensor)
    shape = sensor.camera.shape
    u, v = _grid(shape)
    fields = sample_instances(
        described, sensor.pixel_mm, shape, _N_INSTANCES, np.random.default_rng(0)
    )
    tilted = np.einsum("gp,nkpi->nkgi", compute_position_terms(u, v), fields[..., :2])
    usual = compute_mean_reference_light(sensor.camera, described) + slope_model.OFFSET_GREY
    row, col = (
        np.rint(0.5 * (max(shape) * w + n - 1)).astype(np.intp)
        for w, n in zip((v, u), shape, strict=True)
    )
    level = np.zeros(shape, np.float32)
    steep = np.full(shape, _SMALL_SLOPE, np.float32)
    rates = [
        compute_colour_change(sensor, *g)[row, col] / _SMALL_SLOPE
        for g in ((steep, level), (level, steep))
    ]
    # of a normal's tilt, (places, colours, 2)
    change = -slope_model.SPAN_GREY * np.stack(rates, axis=-1) / usual[:, None]
    size = np.maximum((change**2).sum(axis=-1), 1e-9)
    gains = np.median(np.einsum("nkgi,gki->ngk", tilted, change) / size, axis=0)
    return freeze(np.clip(gains, *_GAINS).reshape(*_GRID, 3).astype(np.float32))


def _draw_leds(
    optics: Optics, x_mm: Doubles, y_mm: Doubles, count: int, rng: np.random.Generator
) -> Callable[[float], Doubles]:
    """LEDs of `count` instances above points (n,) in mm, as their light on level gel there.

    The function returns direction times strength (instances, LEDs, n, 3), 1 at the centre, on a
    surface raised by an indentation in mm.
    """
    per_led = (count, len(optics.leds))
    per_instance = (count, 1)
    azimuth = np.radians(
        [led.azimuth_deg for led in optics.leds] + rng.normal(0.0, _AZIMUTH_DEG, per_led)
    )
    elevation = np.array([led.elevation_deg for led in optics.leds]) + rng.normal(
        0.0, _ELEVATION_DEG, per_instance
    )
    elevation = np.radians(
        np.clip(elevation + rng.normal(0.0, _LED_ELEVATION_DEG, per_led), *_ELEVATIONS_DEG)
    )
    edge = np.abs(x_mm).max() * np.abs(np.cos(azimuth)) + np.abs(y_mm).max() * np.abs(
        np.sin(azimuth)
    )
    away = rng.uniform(*_DISTANCE, per_instance) * np.exp(rng.normal(0.0, 0.1, per_led))
    away = edge * np.maximum(away, _NEAREST)
    hits = (rng.uniform(-1.0, 1.0, per_instance) + rng.normal(0.0, 0.2, per_led)) * edge
    width = np.radians(
        rng.uniform(*_BEAM_WIDTH_DEG, per_instance) * np.exp(rng.normal(0.0, 0.1, per_led))
    )
    spread = np.radians(rng.uniform(*_STRIP_DEG, (count, 1, 1))) * np.array([-1.0, 0.0, 1.0])
    bearing = azimuth[..., None] + spread  # (instances, LEDs, strip)
    height = (away * np.tan(elevation))[..., None, None]
    # of shape (instances, LEDs, strip, n)
    to_x = (away[..., None] * np.cos(bearing))[..., None] - x_mm
    to_y = (away[..., None] * np.sin(bearing))[..., None] - y_mm
    across = np.hypot(to_x, to_y)
    beam = tuple(
        a[..., None, None] for a in (elevation, np.arctan2(height[..., 0, 0], away - hits), width)
    )
    reach = np.hypot(away, height[..., 0, 0])[..., None, None]
    falloff = rng.uniform(*_FALLOFF_POWER, (count, 1, 1, 1))

    def compute_light(indentation_mm: float) -> Doubles:
        elevation, axis, width = beam
        up = height - indentation_mm
        distance = np.hypot(across, up)
        off = (np.arctan2(up, across) - axis) / width
        centre_off = (elevation - axis) / width
        strength = (reach / distance) ** falloff * np.exp(0.5 * (centre_off**2 - off**2)) / distance
        towards = (to_x, to_y, np.broadcast_to(up, distance.shape))
        return np.stack([(strength * part).mean(axis=2) for part in towards], axis=-1)

    return compute_light


def _grid(shape: tuple[int, int]) -> tuple[Doubles, Doubles]:
    u, v = slope_model.compute_positions(shape)
    rows, cols = _GRID
    down, across = np.meshgrid(
        np.linspace(v[0], v[-1], rows), np.linspace(u[0], u[-1], cols), indexing="ij"
    )
    return across.ravel().astype(np.float64), down.ravel().astype(np.float64)


def _compute_misfit(shape: tuple[int, int], size: float) -> Doubles:
    """Covariance (m, m) of smooth fields that no such instance has, as polynomial coefficients."""
    u, v = _grid(shape)
    apart_sq = (u[:, None] - u) ** 2 + (v[:, None] - v) ** 2
    back = np.linalg.pinv(compute_position_terms(u, v))
    field = back @ np.exp(-0.5 * apart_sq / _MISFIT_REACH**2) @ back.T
    field += _RIDGE * np.trace(field) * np.eye(N_POSITION_TERMS)
    share = (_MISFIT * size) ** 2 * np.array([1.0, 1.0, _LEVEL_MISFIT**2, 1.0])
    return np.kron(np.eye(3), np.kron(field, np.diag(share)))
