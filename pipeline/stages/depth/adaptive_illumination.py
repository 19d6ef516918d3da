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
from pipeline.calibration import near_led_prior, shading_field, shading_posterior, slope_model
from pipeline.calibration.shading_field import SurfaceSamples
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import led_calibration, shadow_led_calibration, shadow_model, surface_refinement
from pipeline.stages.depth.poisson import Integrator
from pipeline.stages.depth.shadow_model import LedArray
from pipeline.stages.depth.surface_refinement import ImagePatch, LightModel, blur_change

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
Illumination = LightModel | Optics | LedArray | Doubles
IntegratorFactory = Callable[[ImagePatch], Integrator]  # what makes slopes of those pixels a surface


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptedSurface:
    """A surface in the light that its touch speaks for."""

    surface_mm: Floats  # (rows, cols)
    coefficients: Doubles  # (m,) of the light, `light_field`
    misfit: float  # of the picture, as `gel_light.corrected` has it


def fit_illumination(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, integrates: IntegratorFactory, iterations: int = surface_refinement.MAX_ITERATIONS,
    known_light: Illumination | None = None,
) -> tuple[Floats, Illumination]:  # fmt: skip
    """The surface by the light that explains most of the picture, and that light; one `known` is not looked for.

    Lamps of some unit that explain the picture come first. Where dents cast shadows and neither they nor the described
    light explain it, lamps whose light is lost once are tried. The touch's own field has to explain far more than the
    described light. Lamps that cast shadows stand low and aside: they shine evenly. Described light that explains most
    of the picture is "sure". `rounds` are those of `gel_light.corrected`; fewer make a draft, which takes no more turns
    either.
    """
    integrated = integrates(picture)
    if known_light is not None:
        steps = surface_refinement.FINE_CG_STEPS if iterations <= _DRAFTED else surface_refinement.CG_STEPS
        return refine_in_light(known_light, surface_mm, picture, source, integrated, iterations, steps), known_light
    surface, misfit = surface_refinement.refine_surface(surface_mm, picture, source, "even", integrated, iterations)
    lamps = led_calibration.fit_leds(
        source,
        [make_led_observation(surface, picture, source, integrates)],
        min(iterations, led_calibration.MAX_ITERATIONS),
    )
    if lamps is not None:
        unit = replace(source, optics=lamps)
        return surface_refinement.refine_surface(surface, picture, unit, "sure", integrated, _surer(iterations))[
            0
        ], lamps
    if optics.require_optics(source).shadow > 0:
        found = _surely(surface, picture, source, integrated, iterations)
        if is_trusted(found[1]) or misfit <= _EXPLAINED * led_calibration.sum_change_grey(picture):
            return found
        return _cast(surface_mm, picture, source, integrates, iterations) or found
    own = adapt_field(surface_mm, picture, source, integrated, min(iterations, _TURNS), misfit)
    if own is not None and misfit > _FAR_MORE * own.misfit:
        return own.surface_mm, own.coefficients
    other, left = surface_refinement.refine_surface(surface_mm, picture, source, "near", integrated, iterations)
    return _surely(surface, picture, source, integrated, iterations) if misfit <= _CLEARLY * left else (other, "near")


def is_trusted(light: Illumination | None) -> bool:
    """Whether a light is known to explain the picture, so that pixels count as far as they tell."""
    return isinstance(light, Optics) or (isinstance(light, str) and light == "sure")


def _surer(rounds: int) -> int:
    """Rounds in a light that is sure, in which walls rise for longer; no more of them for a draft."""
    return rounds if rounds <= _DRAFTED else _SURER * rounds


def make_led_observation(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, integrates: IntegratorFactory
) -> led_calibration.LedObservation:
    """What a touch whose surface is about known says of its unit's lamps."""
    cells = surface_refinement.downsample_patch(picture, source.camera.shape, led_calibration.GRID_CELLS)
    surface = (
        surface_refinement.compute_cell_means(surface_mm, cells.downsampling // picture.downsampling)
        if cells is not picture
        else surface_mm
    )
    return led_calibration.LedObservation(patch=cells, surface_mm=surface, integrate=integrates(cells))


def _surely(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, integrated: Integrator, rounds: int
) -> tuple[Floats, LightModel]:
    """The surface of described light once its pixels count as far as they tell, if that light explains the picture."""
    found, left = surface_refinement.refine_surface(surface_mm, picture, source, "sure", integrated, _surer(rounds))
    return (found, "sure") if left <= _EXPLAINED * led_calibration.sum_change_grey(picture) else (surface_mm, "even")


def _cast(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, integrates: IntegratorFactory, rounds: int
) -> tuple[Floats, LedArray] | None:
    """The surface in the light of lamps whose light is lost once, if some usual unit's explain the picture."""
    lamps = shadow_led_calibration.fit_shadow_leds(
        source,
        make_led_observation(surface_mm, picture, source, integrates),
        min(rounds, shadow_led_calibration.MAX_ITERATIONS),
    )
    if lamps is None:
        return None
    return refine_in_light(
        lamps, surface_mm, picture, source, integrates(picture), rounds, shadow_model.CG_STEPS
    ), lamps


def refine_in_light(
    light: Illumination, surface_mm: Floats, picture: ImagePatch, source: SensorSpec, integrated: Integrator, iterations: int,
    cg_steps: int = surface_refinement.CG_STEPS,
) -> Floats:  # fmt: skip
    """A surface (rows, cols) corrected in a light that `best` has found."""
    if isinstance(light, Optics):
        source, light = replace(source, optics=light), "sure"
    if isinstance(light, LedArray):
        return shadow_model.refine_surface(surface_mm, picture, source, light, integrated, iterations, cg_steps)[0]
    if isinstance(light, str):
        if light == "sure" and iterations > _DRAFTED:
            surface_mm = surface_refinement.refine_surface(surface_mm, picture, source, "even", integrated, iterations)[
                0
            ]
            iterations = _surer(iterations)
        return surface_refinement.refine_surface(surface_mm, picture, source, light, integrated, iterations, cg_steps)[
            0
        ]
    return refine_in_field(surface_mm, picture, source, light, integrated, iterations)[0]


def adapt_field(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, integrated: Integrator, max_iterations: int = _TURNS,
    described_misfit: float = math.inf,
) -> AdaptedSurface | None:  # fmt: skip
    """The surface and its light, from a first guess of the surface.

    None where too little has changed to tell, and where the first turn shows that it will not explain far more than
    what `described` light leaves: as good as all touches of a GelSlim.
    """
    q = picture.change * slope_model.compute_gain(picture.reference)
    seen = np.flatnonzero(picture.changed & (np.abs(q).max(axis=2) > _CHANGED))
    if len(seen) < _FEWEST:
        return None
    before = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
    seen = np.random.default_rng(0).choice(seen, min(_PIXELS, len(seen)), replace=False)
    coefficients, misfit = before.mean, 0.0
    surface_mm = refine_in_field(surface_mm, picture, source, coefficients, integrated, _FIRST_ROUNDS)[0]
    for _ in range(max_iterations):
        tried = [_shown(surface_mm * np.float32(depth), picture, source, q, seen) for depth in _DEPTHS]
        best, coefficients = shading_posterior.choose_likeliest_surface(before, tried)
        surface_mm, misfit = refine_in_field(
            surface_mm * np.float32(_DEPTHS[best]), picture, source, coefficients, integrated, _ROUNDS
        )
        if described_misfit <= _HOPELESS * misfit:
            return None
    return AdaptedSurface(surface_mm=surface_mm, coefficients=coefficients, misfit=misfit)


def refine_in_field(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, light: Doubles, integrated: Integrator, iterations: int
) -> tuple[Floats, float]:
    """The surface (rows, cols) of the pixels whose picture, in this light, comes nearest to the one seen.

    And what it leaves of it, as `gel_light.corrected` has it.
    """
    from pipeline.stages.depth.adaptive_illumination_kernels import render_pixels, update_slopes

    field = shading_posterior.expand_field(light, *_place(picture, source))
    field /= slope_model.compute_gain(picture.reference)[..., None]
    out, misfit = np.empty_like(picture.change), 0.0
    limits = (np.float32(_PULL), np.float32(surface_refinement.HUBER_GREY), _STEEPEST)
    for _ in range(iterations):
        z = _within(surface_mm, picture, source)
        gx, gy = compute_slopes(z, picture.pixel_mm)
        render_pixels(gx, gy, z, field, out)
        rest = picture.change - blur_change(out, source, picture)
        misfit = update_slopes(rest, picture.change, picture.reference, picture.changed, field, *limits, gx, gy)
        surface_mm = integrated(gx, gy)
    return surface_mm, misfit


def _shown(
    surface_mm: Floats, picture: ImagePatch, source: SensorSpec, q: Floats, seen: NDArray[np.intp]
) -> SurfaceSamples:
    """The pixels `seen` of a surface, as blurred as the picture shows it."""
    import cv2

    width = max(0.3, math.hypot(optics.require_optics(source).blur_px, picture.smoothing_px) / picture.downsampling)
    z = np.asarray(cv2.GaussianBlur(_within(surface_mm, picture, source), (0, 0), width), np.float32)
    u, v = _place(picture, source)
    row, col = np.divmod(seen, z.shape[1])
    steep = np.stack([g.ravel()[seen] for g in compute_slopes(z, picture.pixel_mm)], axis=1).astype(np.float64)
    parts = shading_field.compute_shading_terms(steep, z.ravel()[seen].astype(np.float64))
    return SurfaceSamples(u=u[col], v=v[row], shading_terms=parts, change=q.reshape(-1, 3)[seen])


def _within(surface_mm: Floats, picture: ImagePatch, source: SensorSpec) -> Floats:
    return np.clip(surface_mm, _LEAST_MM, source.limits.indentation_max_mm) * picture.changed


def _place(picture: ImagePatch, source: SensorSpec) -> tuple[Floats, Floats]:
    """Where the columns and rows lie, as `slope_model.position` has it."""
    rows, cols = source.camera.shape
    half = np.float32(0.5 * max(rows, cols))
    u, v = (picture.x_px - np.float32(0.5 * (cols - 1))) / half, (picture.y_px - np.float32(0.5 * (rows - 1))) / half
    return u.astype(np.float32), v.astype(np.float32)
