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
from pipeline.physics.slopes import slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import cast_light, gel_light, unexplained
from pipeline.stages.depth.cast_light import Lamps
from pipeline.stages.depth.gel_light import Seen
from pipeline.stages.depth.own_lamps import Touch

TURNS, _ROUNDS, _STEPS = 4, 2, 8
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


def fitted(source: SensorSpec, touch: Touch, turns: int = TURNS) -> Lamps | None:
    """The lamps, of those that the turns come by, that leave least of the picture; None where no such explain it."""
    from threadpoolctl import threadpool_limits

    base, picture, surface = cast_light.described(source), touch.picture, touch.surface_mm
    spread = _spread(base)
    n, before = len(base.azimuth), np.diag(1.0 / spread**2)
    before[n : 2 * n, n : 2 * n] += _NOT_TOLD
    steps, lamps, found, least, off = np.zeros(len(spread)), base, base, math.inf, 0.0
    # Several threads would add up in another order.
    with threadpool_limits(limits=1, user_api="blas"):
        for turn in range(turns + 1):
            surface, left = cast_light.corrected(surface, picture, source, lamps, touch.integrated, _ROUNDS, _STEPS)
            if left >= least:
                break
            least, found, off = left, lamps, float(((steps / spread) ** 2).sum())
            if turn < turns:
                normal, pull = _told(base, steps, spread, replace(touch, surface_mm=surface), source)
                step = np.linalg.solve(normal + before, pull - before @ steps)
                steps = steps + step * min(1.0, _FARTHEST / max(math.sqrt(float(step @ before @ step)), 1e-9))
                lamps = _moved(base, steps)
    share = least / max(_changed(picture), 1.0)
    return found if share < _MOST_LEFT and off / _UNLIKELY + share / _LEFT < 1.0 else None


def _changed(picture: Seen) -> float:
    """What has changed, summed as what is left of it is."""
    changed = np.abs(picture.change) * cast_light.certain(picture)
    return float(np.minimum(changed, np.float32(2.0 * gel_light.HUBER_GREY))[picture.moved].sum())


def _spread(base: Lamps) -> Doubles:
    """Standard deviations (5 n,): azimuths, elevations, shares (3, n)."""
    n = len(base.azimuth)
    shares = np.where(base.share > _MAIN * base.share.max(), _OWN, _CROSS)
    return np.concatenate([np.full(n, _AZIMUTH), np.full(n, _HIGHER), shares.ravel()])


def _moved(base: Lamps, steps: Doubles) -> Lamps:
    """The lamps that lie `steps` (5 n,) beside the description's."""
    n = len(base.azimuth)
    return replace(
        base,
        azimuth=base.azimuth + steps[:n],
        elevation=np.arctan(np.tan(base.elevation) * np.exp(steps[n : 2 * n])),
        share=np.clip(base.share + steps[2 * n :].reshape(3, n), *_SHARES),
    )


def _told(base: Lamps, steps: Doubles, spread: Doubles, touch: Touch, source: SensorSpec) -> tuple[Doubles, Doubles]:
    """What the picture says of the numbers beyond what its surface explains: the normal equations (m, m), (m,)."""
    picture, lamps = touch.picture, _moved(base, steps)
    surface = cast_light.within(touch.surface_mm, picture, source)
    gx, gy = slopes(surface, picture.pixel_mm)
    slope_step = unexplained.SLOPE_STEP

    def shown(by: Lamps, sx: Floats, sy: Floats) -> Floats:
        return cast_light.shown(by, picture, cast_light.passed(by, surface, picture.pixel_mm), sx, sy)

    level = shown(lamps, gx, gy)
    out = gel_light.blurred(level, source, picture)
    rest = picture.change - gel_light.recorded(level, source, picture)
    weight = unexplained.weights(rest, picture) * cast_light.certain(picture) ** 2
    across = (shown(lamps, gx + slope_step, gy) - level) / slope_step
    down = (shown(lamps, gx, gy + slope_step) - level) / slope_step
    columns = np.empty((len(steps), *out.shape), np.float32)
    for k, size in enumerate(_STEP * spread):
        there = steps.copy()
        there[k] += size
        other = _moved(base, there)
        columns[k] = (gel_light.blurred(shown(other, gx, gy), source, picture) - out) / np.float32(size)
    unexplained.beyond_surface(columns, across, down, weight, picture, touch.integrated)
    flat = columns.reshape(len(steps), -1).astype(np.float64)
    share = min(1.0, _WORTH / max(1, np.count_nonzero(picture.moved))) / _NOISE_GREY**2
    weighed = flat * (share * weight.ravel())
    return weighed @ flat.T, weighed @ rest.ravel()
