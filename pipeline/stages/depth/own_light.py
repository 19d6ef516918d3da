"""A gel's surface by the light that the touch itself speaks for, where lamps stand close beside the gel.

How near lamps change colours differs between units more than their untouched pictures tell, and within one picture
many times over: beside a lamp a slope hardly changes its colour. In turns, the surface is solved for in the light as it
is known (`gel_light`, with the field in place of lamps), and the light for the surface (`touch_light`), its depth
included.

Lamps that shine as described, but aside, stronger or weaker, are fitted first (`own_lamps`): where some unit's explain
the picture, no other light is looked for. Where dents cast shadows, those come next of which a surface loses light once
(`cast_lamps`): as on a real DIGIT.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats
from pipeline.calibration import light_field, near_lamps, slope_model, touch_light
from pipeline.calibration.light_field import Surface
from pipeline.physics import optics
from pipeline.physics.slopes import slopes
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import cast_lamps, cast_light, gel_light, own_lamps
from pipeline.stages.depth.cast_light import Lamps
from pipeline.stages.depth.gel_light import Light, Seen, blurred
from pipeline.stages.depth.poisson import Integrated

_TURNS, _ROUNDS, _FIRST_ROUNDS = 3, 2, 3
_DEPTHS = (0.8, 1.0, 1.25)  # of the surface, tried in every turn
_PIXELS, _FEWEST = 1500, 60  # looked at, and fewer speak for no light
_FAR_MORE = (
    2.5  # times what its own light leaves: simulated Minis as described 1.0 to 1.9, balls on a real one 3.1 to 5.9
)
_HOPELESS = 1.5  # times, after any turn: two more gain 1.4 at most
_CLEARLY = 0.95  # of near lamps' misfit: simulated units as described leave 0.56 to 0.94 of it, real ones mostly more
_CHANGED = 0.1  # of q: slopes that are read, not noise
_EXPLAINED = 0.6  # of the change, left at most: simulated presses on other units leave 0.10 to 0.56, real ones 0.63 on
_PULL = 20.0  # grey levels squared per unit slope squared: in weak light a colour weighs no more than a hundred
_STEEPEST = np.float32(1.43)  # mm/mm, 55 degrees
_LEAST_MM = -0.5  # no gel bulges out farther
_SURER = 2  # times as many rounds; five times as many leave a twentieth less of a wall's height to find
_DRAFTED = 2  # rounds of a draft: two thirds of the time, and 23 um from the whole answer where it touches, not 21

# As described, by lamps of the unit's own (`own_lamps`), by such whose light is lost once (`cast_light`), or the
# coefficients of a field (`light_field`).
Told = Light | Optics | Lamps | Doubles
Integrates = Callable[[Seen], Integrated]  # what makes slopes of those pixels a surface


@dataclass(frozen=True, slots=True, kw_only=True)
class Own:
    """A surface in the light that its touch speaks for."""

    surface_mm: Floats  # (rows, cols)
    coefficients: Doubles  # (m,) of the light, `light_field`
    misfit: float  # of the picture, as `gel_light.corrected` has it


def best(
    surface_mm: Floats, picture: Seen, source: SensorSpec, integrates: Integrates, rounds: int = gel_light.ROUNDS,
    known: Told | None = None,
) -> tuple[Floats, Told]:  # fmt: skip
    """The surface by the light that explains most of the picture, and that light; one `known` is not looked for.

    Lamps of some unit that explain the picture come first. Where dents cast shadows and neither they nor the described
    light explain it, lamps whose light is lost once are tried. The touch's own field has to explain far more than the
    described light. Lamps that cast shadows stand low and aside: they shine evenly. Described light that explains most
    of the picture is "sure". `rounds` are those of `gel_light.corrected`; fewer make a draft, which takes no more turns
    either.
    """
    integrated = integrates(picture)
    if known is not None:
        steps = gel_light.FINE_STEPS if rounds <= _DRAFTED else gel_light.STEPS
        return read_by(known, surface_mm, picture, source, integrated, rounds, steps), known
    surface, misfit = gel_light.corrected(surface_mm, picture, source, "even", integrated, rounds)
    lamps = own_lamps.fitted(source, [touch(surface, picture, source, integrates)], min(rounds, own_lamps.TURNS))
    if lamps is not None:
        unit = replace(source, optics=lamps)
        return gel_light.corrected(surface, picture, unit, "sure", integrated, _surer(rounds))[0], lamps
    if optics.optics_of(source).shadow > 0:
        found = _surely(surface, picture, source, integrated, rounds)
        if explains(found[1]) or misfit <= _EXPLAINED * own_lamps.changed_grey(picture):
            return found
        return _cast(surface_mm, picture, source, integrates, rounds) or found
    own = adapted(surface_mm, picture, source, integrated, min(rounds, _TURNS), misfit)
    if own is not None and misfit > _FAR_MORE * own.misfit:
        return own.surface_mm, own.coefficients
    other, left = gel_light.corrected(surface_mm, picture, source, "near", integrated, rounds)
    return _surely(surface, picture, source, integrated, rounds) if misfit <= _CLEARLY * left else (other, "near")


def explains(light: Told | None) -> bool:
    """Whether a light is known to explain the picture, so that pixels count as far as they tell."""
    return isinstance(light, Optics) or (isinstance(light, str) and light == "sure")


def _surer(rounds: int) -> int:
    """Rounds in a light that is sure, in which walls rise for longer; no more of them for a draft."""
    return rounds if rounds <= _DRAFTED else _SURER * rounds


def touch(surface_mm: Floats, picture: Seen, source: SensorSpec, integrates: Integrates) -> own_lamps.Touch:
    """What a touch whose surface is about known says of its unit's lamps."""
    cells = gel_light.coarser(picture, source.camera.shape, own_lamps.CELLS)
    surface = gel_light.means(surface_mm, cells.by // picture.by) if cells is not picture else surface_mm
    return own_lamps.Touch(picture=cells, surface_mm=surface, integrated=integrates(cells))


def _surely(
    surface_mm: Floats, picture: Seen, source: SensorSpec, integrated: Integrated, rounds: int
) -> tuple[Floats, Light]:
    """The surface of described light once its pixels count as far as they tell, if that light explains the picture."""
    found, left = gel_light.corrected(surface_mm, picture, source, "sure", integrated, _surer(rounds))
    return (found, "sure") if left <= _EXPLAINED * own_lamps.changed_grey(picture) else (surface_mm, "even")


def _cast(
    surface_mm: Floats, picture: Seen, source: SensorSpec, integrates: Integrates, rounds: int
) -> tuple[Floats, Lamps] | None:
    """The surface in the light of lamps whose light is lost once, if some usual unit's explain the picture."""
    lamps = cast_lamps.fitted(source, touch(surface_mm, picture, source, integrates), min(rounds, cast_lamps.TURNS))
    if lamps is None:
        return None
    return read_by(lamps, surface_mm, picture, source, integrates(picture), rounds, cast_light.STEPS), lamps


def read_by(
    light: Told, surface_mm: Floats, picture: Seen, source: SensorSpec, integrated: Integrated, rounds: int,
    steps: int = gel_light.STEPS,
) -> Floats:  # fmt: skip
    """A surface (rows, cols) corrected in a light that `best` has found."""
    if isinstance(light, Optics):
        source, light = replace(source, optics=light), "sure"
    if isinstance(light, Lamps):
        return cast_light.corrected(surface_mm, picture, source, light, integrated, rounds, steps)[0]
    if isinstance(light, str):
        if light == "sure" and rounds > _DRAFTED:
            surface_mm = gel_light.corrected(surface_mm, picture, source, "even", integrated, rounds)[0]
            rounds = _surer(rounds)
        return gel_light.corrected(surface_mm, picture, source, light, integrated, rounds, steps)[0]
    return corrected(surface_mm, picture, source, light, integrated, rounds)[0]


def adapted(
    surface_mm: Floats, picture: Seen, source: SensorSpec, integrated: Integrated, turns: int = _TURNS,
    described: float = math.inf,
) -> Own | None:  # fmt: skip
    """The surface and its light, from a first guess of the surface.

    None where too little has changed to tell, and where the first turn shows that it will not explain far more than
    what `described` light leaves: as good as all touches of a GelSlim.
    """
    q = picture.change * slope_model.gain(picture.still)
    seen = np.flatnonzero(picture.moved & (np.abs(q).max(axis=2) > _CHANGED))
    if len(seen) < _FEWEST:
        return None
    before = near_lamps.prior(source, source.pixel_mm, source.camera.shape)
    seen = np.random.default_rng(0).choice(seen, min(_PIXELS, len(seen)), replace=False)
    coefficients, misfit = before.mean, 0.0
    surface_mm = corrected(surface_mm, picture, source, coefficients, integrated, _FIRST_ROUNDS)[0]
    for _ in range(turns):
        tried = [_shown(surface_mm * np.float32(depth), picture, source, q, seen) for depth in _DEPTHS]
        best, coefficients = touch_light.likeliest(before, tried)
        surface_mm, misfit = corrected(
            surface_mm * np.float32(_DEPTHS[best]), picture, source, coefficients, integrated, _ROUNDS
        )
        if described <= _HOPELESS * misfit:
            return None
    return Own(surface_mm=surface_mm, coefficients=coefficients, misfit=misfit)


def corrected(
    surface_mm: Floats, picture: Seen, source: SensorSpec, light: Doubles, integrated: Integrated, rounds: int
) -> tuple[Floats, float]:
    """The surface (rows, cols) of the pixels whose picture, in this light, comes nearest to the one seen.

    And what it leaves of it, as `gel_light.corrected` has it.
    """
    from pipeline.stages.depth.own_light_kernels import explained, lit

    field = touch_light.image(light, *_place(picture, source))
    field /= slope_model.gain(picture.still)[..., None]
    out, misfit = np.empty_like(picture.change), 0.0
    limits = (np.float32(_PULL), np.float32(gel_light.HUBER_GREY), _STEEPEST)
    for _ in range(rounds):
        z = _within(surface_mm, picture, source)
        gx, gy = slopes(z, picture.pixel_mm)
        lit(gx, gy, z, field, out)
        rest = picture.change - blurred(out, source, picture)
        misfit = explained(rest, picture.change, picture.still, picture.moved, field, *limits, gx, gy)
        surface_mm = integrated(gx, gy)
    return surface_mm, misfit


def _shown(surface_mm: Floats, picture: Seen, source: SensorSpec, q: Floats, seen: NDArray[np.intp]) -> Surface:
    """The pixels `seen` of a surface, as blurred as the picture shows it."""
    import cv2

    width = max(0.3, math.hypot(optics.optics_of(source).blur_px, picture.smoothing_px) / picture.by)
    z = np.asarray(cv2.GaussianBlur(_within(surface_mm, picture, source), (0, 0), width), np.float32)
    u, v = _place(picture, source)
    row, col = np.divmod(seen, z.shape[1])
    steep = np.stack([g.ravel()[seen] for g in slopes(z, picture.pixel_mm)], axis=1).astype(np.float64)
    parts = light_field.parts_of_slopes(steep, z.ravel()[seen].astype(np.float64))
    return Surface(u=u[col], v=v[row], parts=parts, change=q.reshape(-1, 3)[seen])


def _within(surface_mm: Floats, picture: Seen, source: SensorSpec) -> Floats:
    return np.clip(surface_mm, _LEAST_MM, source.limits.indentation_max_mm) * picture.moved


def _place(picture: Seen, source: SensorSpec) -> tuple[Floats, Floats]:
    """Where the columns and rows lie, as `slope_model.position` has it."""
    rows, cols = source.camera.shape
    half = np.float32(0.5 * max(rows, cols))
    u, v = (picture.x_px - np.float32(0.5 * (cols - 1))) / half, (picture.y_px - np.float32(0.5 * (rows - 1))) / half
    return u.astype(np.float32), v.astype(np.float32)
