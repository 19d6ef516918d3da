"""The lamps of a unit whose light is lost once (`cast_light`), as one touch tells of them.

As in `own_lamps`, numbers t beside the description speak by what no surface explains of the picture: where each lamp
stands, how high beside the others, and what it gives of every colour. How high all stand together is not looked for:
the size of a touch trades with it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import shadow_model, surface_refinement, variable_projection
from pipeline.stages.depth.led_calibration import LedObservation
from pipeline.stages.depth.shadow_model import LedArray
from pipeline.stages.depth.surface_refinement import ImagePatch

MAX_ITERATIONS, _ROUNDS, _STEPS = 4, 2, 8
# Standard deviations between units, found on real presses: of azimuth, of the logarithm of the elevation's tangent, of
# shares of light in a lamp's own colour and in others.
_AZIMUTH, _HIGHER, _OWN, _CROSS = math.radians(8.0), 0.12, 0.15, 0.05
_NOT_TOLD = 1e6  # how surely all lamps together stand as high as described
_SHARES = (-0.3, 0.9)
_MAIN = 0.5  # of the largest share: a lamp's own colour
# Of the change, left, and of t' C^-1 t: as much of both together as one alone may be, and as much left. Half of the
# presses on a real DIGIT have up to 0.98 of it and leave up to 0.52. So little have 5 of 1,050 simulated ones on other
# units that no usual lamps explain: three are read better by these, two worse.
_LEFT, _UNLIKELY, _MOST_LEFT = 0.88, 95.0, 0.55
_STEP = 0.15  # standard deviations, for rates of change
_NOISE_GREY, _WORTH = 6.0, 200.0  # of a colour; pixels of a touch that can be independent
_FARTHEST = 4.0  # of a turn, as units are far from each other


def fit_shadow_leds(source: SensorSpec, touch: LedObservation, max_iterations: int = MAX_ITERATIONS) -> LedArray | None:
    """The lamps, of those that the turns come by, that leave least of the picture; None where no such explain it."""
    from threadpoolctl import threadpool_limits

    base, picture, surface = shadow_model.make_described_leds(source), touch.patch, touch.surface_mm
    spread = _spread(base)
    n, before = len(base.azimuth_rad), np.diag(1.0 / spread**2)
    before[n : 2 * n, n : 2 * n] += _NOT_TOLD
    steps, lamps, found, least, off = np.zeros(len(spread)), base, base, math.inf, 0.0
    # Several threads would add up in another order.
    with threadpool_limits(limits=1, user_api="blas"):
        for turn in range(max_iterations + 1):
            surface, left = shadow_model.refine_surface(
                surface, picture, source, lamps, touch.integrate, _ROUNDS, _STEPS
            )
            if left >= least:
                break
            least, found, off = left, lamps, float(((steps / spread) ** 2).sum())
            if turn < max_iterations:
                normal, pull = _told(base, steps, spread, replace(touch, surface_mm=surface), source)
                step = np.linalg.solve(normal + before, pull - before @ steps)
                steps = steps + step * min(1.0, _FARTHEST / max(math.sqrt(float(step @ before @ step)), 1e-9))
                lamps = _moved(base, steps)
    share = least / max(_changed(picture), 1.0)
    return found if share < _MOST_LEFT and off / _UNLIKELY + share / _LEFT < 1.0 else None


def _changed(picture: ImagePatch) -> float:
    """What has changed, summed as what is left of it is."""
    changed = np.abs(picture.change) * shadow_model.compute_confidence(picture)
    return float(np.minimum(changed, np.float32(2.0 * surface_refinement.HUBER_GREY))[picture.changed].sum())


def _spread(base: LedArray) -> Doubles:
    """Standard deviations (5 n,): azimuths, elevations, shares (3, n)."""
    n = len(base.azimuth_rad)
    shares = np.where(base.colour_share > _MAIN * base.colour_share.max(), _OWN, _CROSS)
    return np.concatenate([np.full(n, _AZIMUTH), np.full(n, _HIGHER), shares.ravel()])


def _moved(base: LedArray, steps: Doubles) -> LedArray:
    """The lamps that lie `steps` (5 n,) beside the description's."""
    n = len(base.azimuth_rad)
    return replace(
        base,
        azimuth_rad=base.azimuth_rad + steps[:n],
        elevation_rad=np.arctan(np.tan(base.elevation_rad) * np.exp(steps[n : 2 * n])),
        colour_share=np.clip(base.colour_share + steps[2 * n :].reshape(3, n), *_SHARES),
    )


def _told(
    base: LedArray, steps: Doubles, spread: Doubles, touch: LedObservation, source: SensorSpec
) -> tuple[Doubles, Doubles]:
    """What the picture says of the numbers beyond what its surface explains: the normal equations (m, m), (m,)."""
    picture, lamps = touch.patch, _moved(base, steps)
    surface = shadow_model.clip_surface(touch.surface_mm, picture, source)
    gx, gy = compute_slopes(surface, picture.pixel_mm)
    slope_step = variable_projection.SLOPE_STEP

    def render_level_change(by: LedArray, sx: Floats, sy: Floats) -> Floats:
        return shadow_model.render_change(
            by, picture, shadow_model.compute_visibility(by, surface, picture.pixel_mm), sx, sy
        )

    level = render_level_change(lamps, gx, gy)
    out = surface_refinement.blur_change(level, source, picture)
    rest = picture.change - surface_refinement.simulate_recorded_change(level, source, picture)
    weight = variable_projection.compute_colour_weights(rest, picture) * shadow_model.compute_confidence(picture) ** 2
    across = (render_level_change(lamps, gx + slope_step, gy) - level) / slope_step
    down = (render_level_change(lamps, gx, gy + slope_step) - level) / slope_step
    columns = np.empty((len(steps), *out.shape), np.float32)
    for k, size in enumerate(_STEP * spread):
        there = steps.copy()
        there[k] += size
        other = _moved(base, there)
        columns[k] = (
            surface_refinement.blur_change(render_level_change(other, gx, gy), source, picture) - out
        ) / np.float32(size)
    variable_projection.project_out_surface(columns, across, down, weight, picture, touch.integrate)
    flat = columns.reshape(len(steps), -1).astype(np.float64)
    share = min(1.0, _WORTH / max(1, np.count_nonzero(picture.changed))) / _NOISE_GREY**2
    weighed = flat * (share * weight.ravel())
    return weighed @ flat.T, weighed @ rest.ravel()
