"""The lamps of a unit as its touches tell of them: as described, but aside, stronger or weaker.

Units differ in where their lamps stand and what they give, in how light falls off, in the lens, in how long shadows
are: numbers t beside the description, of which it is known beforehand how far units differ, C. Whatever they are, the
surface explains as much of the picture as it can; what speaks for them is what no surface explains (variable
projection, Golub and Pereyra 1973). A step dt changes that, summed over all touches, by D dt,

    D = T - J grad P(J^+ T),    dt = (sum D' W D / s^2 + C^-1)^-1 (sum D' W r / s^2 - C^-1 t)

with T, J what numbers and slopes change in the picture, J^+ the slopes that explain a change best, P the surface
nearest to them where each pixel counts as far as it tells, r what is left of the picture and W Huber's weights. How
strong all lamps are is told by slopes that are not small, and by C. Several touches of one unit tell more than one: on
simulated units the light of eight is as good as the true one.

Real units leave more of their pictures, or ask for lamps that are no unit's: they are read in another light
(`own_light`). Both limits lie between simulated units and the recordings that `benchmarks/real_depth.py` reads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.parts import Led, Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import surface_refinement, variable_projection
from pipeline.stages.depth.poisson import Integrator
from pipeline.stages.depth.surface_refinement import ImagePatch

GRID_CELLS = 80  # of the grid, along the longer side of a picture: half of it tells of the lamps as much
MAX_ITERATIONS, _ROUNDS, _STEPS = 4, 2, 8
_AZIMUTH_DEG, _ELEVATION_DEG = 8.0, 3.0  # standard deviations between units, as `simulation.variation` has them
_POWER, _COLOUR = 0.12, 0.08  # of the logarithm: of a whole lamp, of each of its colours
_OTHERS = (0.05, 0.08, 0.15, 0.25, 3.0)  # of fall-off, vignette, blur, shadow (both of the logarithm), its degrees
_STEP = 0.15  # standard deviations, for rates of change
_NOISE_GREY = 6.0  # of a colour: what no lamps explain
_WORTH = 800.0  # pixels of a touch that can be independent
_FARTHEST = 4.0  # of a turn, as units are far from each other: walls are not linear in their lamps
_HOPELESS = 0.65  # of the change, left by described lamps: simulated units 0.10 to 0.58 of it, other units up to 1
_NOISE_LEFT = 1.5  # grey levels a pixel
# Of the change, left beyond noise, and of t' C^-1 t: as much of both together as one alone may be. Simulated units have
# up to 0.99 of it, one in fifty more; single balls on a real Mini from 1.19, other real units from 2.1.
_LEFT, _UNLIKELY = 0.28, 70.0
# Of what t' C^-1 t is of units drawn at random, as many numbers as touches tell: walls and shadows on units that are as
# described make up to 0.2 of it in three touches of four, other units 0.22 at least.
_AS_DESCRIBED = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class LedObservation:
    """A picture, what its surface is about, and what makes slopes of its pixels a surface."""

    patch: ImagePatch
    surface_mm: Floats  # (rows, cols)
    integrate: Integrator


def fit_leds(
    source: SensorSpec, touches: Sequence[LedObservation], max_iterations: int = MAX_ITERATIONS
) -> Optics | None:
    """The optics of the unit that took all these pictures; None where no usual unit's explain them. Needs optics.

    Those described where the touches tell of no other unit.
    """
    from threadpoolctl import threadpool_limits

    base = optics.require_optics(source)
    spread = _spread(len(base.leds))
    certain = np.linalg.inv(spread @ spread.T)
    steps, unit, normal = np.zeros(len(spread)), source, certain
    noise = sum(
        _NOISE_LEFT * float((touch.patch.unmarked_share[..., 0] * touch.patch.changed).sum()) for touch in touches
    )
    changed = sum(sum_change_grey(touch.patch) for touch in touches)
    # Several threads would add up in another order.
    with threadpool_limits(limits=1, user_api="blas"):
        for turn in range(max_iterations):
            touches, left = _seen_in(unit, touches)
            if turn == 0 and left > noise + _HOPELESS * changed:
                return None
            rates = [_rates(unit, base, steps, spread, touch) for touch in touches]
            normal = certain + sum(rate.normal for rate in rates)
            pulls = [rate.weighed.T @ _rest(unit, touch).ravel() for rate, touch in zip(rates, touches, strict=True)]
            step = np.linalg.solve(normal, sum(pulls) - certain @ steps)
            steps = steps + step * min(1.0, _FARTHEST / max(math.sqrt(float(step @ certain @ step)), 1e-9))
            unit = replace(source, optics=_moved(base, steps))
        _, left = _seen_in(unit, touches)
        told = float(np.trace(np.linalg.solve(normal, normal - certain)))
        off = float(steps @ certain @ steps)
    if off / _UNLIKELY + max(0.0, left - noise) / (_LEFT * max(changed, 1.0)) > 1.0:
        return None
    return base if off < _AS_DESCRIBED * told else unit.optics


def _seen_in(unit: SensorSpec, touches: Sequence[LedObservation]) -> tuple[list[LedObservation], float]:
    """The touches with their surfaces in this unit's light, and what it leaves of their pictures."""
    found, left = list[LedObservation](), 0.0
    for touch in touches:
        surface, misfit = surface_refinement.refine_surface(
            touch.surface_mm, touch.patch, unit, "sure", touch.integrate, iterations=_ROUNDS, cg_steps=_STEPS
        )
        found.append(replace(touch, surface_mm=surface))
        left += misfit
    return found, left


def sum_change_grey(picture: ImagePatch) -> float:
    """Grey levels that have changed, summed as what is left of them is."""
    changed = np.minimum(
        np.abs(picture.change * picture.unmarked_share), np.float32(2.0 * surface_refinement.HUBER_GREY)
    )
    return float(changed[picture.changed].sum())


def _spread(n_leds: int) -> Doubles:
    """A root of what is known of the numbers beforehand, (m, m): azimuth, elevation, three colours a lamp, and more."""
    lamp = np.zeros((5, 5))
    lamp[0, 0], lamp[1, 1] = _AZIMUTH_DEG, _ELEVATION_DEG
    lamp[2:, 2:] = np.linalg.cholesky(_COLOUR**2 * np.eye(3) + _POWER**2)
    m = 5 * n_leds
    whole = np.zeros((m + len(_OTHERS), m + len(_OTHERS)))
    whole[:m, :m] = np.kron(np.eye(n_leds), lamp)
    whole[m:, m:] = np.diag(_OTHERS)
    return whole


def _moved(base: Optics, steps: Doubles) -> Optics:
    """The optics that lie `steps` (m,) beside those described."""
    n = len(base.leds)
    falloff, vignette, blur, shadow, shadow_deg = (float(v) for v in steps[5 * n :])
    return replace(
        base,
        leds=tuple(_lamp(led, steps[5 * k : 5 * k + 5]) for k, led in enumerate(base.leds)),
        falloff=min(max(base.falloff + falloff, 0.0), 1.0),
        vignette=min(max(base.vignette + vignette, 0.0), 1.0),
        blur_px=base.blur_px * math.exp(blur),
        shadow=min(base.shadow * math.exp(shadow), 1.0),
        shadow_deg=min(max(base.shadow_deg + shadow_deg, 5.0), 80.0),
    )


def _lamp(led: Led, step: Doubles) -> Led:
    red, green, blue = (float(v * s) for v, s in zip(led.rgb, np.exp(step[2:]), strict=True))
    return Led(
        azimuth_deg=float(led.azimuth_deg + step[0]) % 360.0,
        elevation_deg=min(max(float(led.elevation_deg + step[1]), 5.0), 80.0),
        rgb=(red, green, blue),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rates:
    """How a touch's picture changes with the numbers beyond what its surface explains."""

    weighed: Doubles  # (n, m) W D / s^2, of n colours of pixels
    normal: Doubles  # (m, m) D' W D / s^2


def _rest(unit: SensorSpec, touch: LedObservation) -> Floats:
    """What is left of the picture (rows, cols, 3)."""
    surface = surface_refinement.clip_surface(touch.surface_mm, touch.patch, unit)
    share = surface_refinement.compute_light_share(unit, surface, touch.patch.pixel_mm)
    level = _shown(unit, touch.patch, share, *compute_slopes(surface, touch.patch.pixel_mm))
    return touch.patch.change - surface_refinement.simulate_recorded_change(level, unit, touch.patch)


def _rates(unit: SensorSpec, base: Optics, steps: Doubles, spread: Doubles, touch: LedObservation) -> _Rates:
    picture = touch.patch
    surface = surface_refinement.clip_surface(touch.surface_mm, picture, unit)
    gx, gy = compute_slopes(surface, picture.pixel_mm)
    share = surface_refinement.compute_light_share(unit, surface, picture.pixel_mm)
    level = _shown(unit, picture, share, gx, gy)
    out = surface_refinement.blur_change(level, unit, picture)
    weight = variable_projection.compute_colour_weights(
        picture.change - surface_refinement.simulate_recorded_change(level, unit, picture), picture
    )
    across = (
        _shown(unit, picture, share, gx + variable_projection.SLOPE_STEP, gy) - level
    ) / variable_projection.SLOPE_STEP
    down = (
        _shown(unit, picture, share, gx, gy + variable_projection.SLOPE_STEP) - level
    ) / variable_projection.SLOPE_STEP
    columns = np.zeros((len(steps), *out.shape), np.float32)
    for k, size in enumerate(_STEP * np.sqrt((spread**2).sum(axis=1))):
        there = steps.copy()
        there[k] += size
        other = replace(unit, optics=_moved(base, there))
        if other.optics != unit.optics:  # not a colour that a lamp does not have, nor shadows that no dent casts
            share = surface_refinement.compute_light_share(other, surface, picture.pixel_mm)
            columns[k] = surface_refinement.blur_change(_shown(other, picture, share, gx, gy), other, picture) - out
            columns[k] /= np.float32(size)
    variable_projection.project_out_surface(columns, across, down, weight, picture, touch.integrate)
    columns = columns.reshape(len(steps), -1).T.astype(np.float64)
    share = min(1.0, _WORTH / max(1, np.count_nonzero(picture.changed))) / _NOISE_GREY**2
    weighed = columns * (share * weight.ravel().astype(np.float64))[:, None]
    return _Rates(weighed=weighed, normal=weighed.T @ columns)


def _shown(source: SensorSpec, picture: ImagePatch, share: Floats, gx: Floats, gy: Floats) -> Floats:
    """Grey levels (rows, cols, 3) that slopes change as described, before the lens; `share` of the light gets there."""
    from pipeline.stages.depth.surface_refinement_kernels import TILE_PX, render_pixels

    told, camera = optics.require_optics(source), source.camera
    size = np.array([camera.cols, camera.rows], np.float32)
    place = (picture.x_px, picture.y_px, size, *optics.pack_leds(told, camera), np.float32(told.vignette))
    out, light = np.empty_like(picture.change), (picture.reference, np.ones_like(picture.reference), share)
    line = np.empty(3 * TILE_PX, np.float32)
    render_pixels(
        gx,
        gy,
        place,
        tuple(surface_refinement.flatten_colours(a) for a in light),
        line,
        surface_refinement.flatten_colours(out),
    )
    return out
