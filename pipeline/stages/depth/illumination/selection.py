"""Choice of the light model of a sensor instance from its touches, and correction of a surface in that light.

The candidates are tried in the order of `CANDIDATES`; the first that explains the touches is taken, and the described
light where none does. `docs/illumination.md` says which recordings need which.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination import led_light, shadow_light
from pipeline.stages.depth.illumination.constants import CONSTANTS
from pipeline.stages.depth.illumination.field_light import fit_field, make_field_light
from pipeline.stages.depth.illumination.light import (
    Illumination,
    IlluminationModel,
    ImagePatch,
    Light,
    compute_cell_means,
    downsample_patch,
    sum_change_grey,
)
from pipeline.stages.depth.illumination.parameter_fit import LedObservation, fit_leds, fit_shadow_leds
from pipeline.stages.depth.illumination.surface_refinement import refine_surface
from pipeline.stages.depth.poisson import Integrator

IntegratorFactory = Callable[[ImagePatch], Integrator]  # makes the integrator of a patch's slopes

DESCRIBED = Illumination()
TRUSTED = Illumination(model="trusted")


@dataclass(frozen=True, kw_only=True)  # without slots, which a cached property needs
class Touch:
    """One touch by which light is chosen."""

    guess_mm: Floats  # (rows, cols) surface by the calibration table
    patch: ImagePatch
    source: SensorSpec
    make_integrator: IntegratorFactory

    @cached_property
    def described(self) -> tuple[Floats, float]:
        """The surface (rows, cols) in the described light, and what that leaves of the image."""
        return self.refine(DESCRIBED, self.guess_mm)

    def refine(self, illumination: Illumination, start_mm: Floats) -> tuple[Floats, float]:
        """The surface (rows, cols) in an illumination, and what that leaves of the image."""
        factor = CONSTANTS.trusted_iteration_factor if illumination.is_trusted else 1
        light = make_light(illumination, self.patch, self.source)
        integrate = self.make_integrator(self.patch)
        return refine_surface(start_mm, self.patch, light, integrate, factor * CONSTANTS.iterations)

    def observe(self, surface_mm: Floats) -> LedObservation:
        """The touch with a surface (rows, cols), on the coarser grid of the LED fit."""
        cells = downsample_patch(self.patch, self.source.camera.shape, CONSTANTS.led_grid_cells)
        if cells is not self.patch:
            surface_mm = compute_cell_means(surface_mm, cells.downsampling // self.patch.downsampling)
        return LedObservation(patch=cells, surface_mm=surface_mm, integrate=self.make_integrator(cells))


def choose_illumination(touches: Sequence[Touch]) -> Illumination:
    """The light that explains the touches of one sensor instance: that of the first candidate that does.

    A model whose parameters differ from place to place has none for several touches: `fit_touch` finds those of each.
    """
    return next((light for candidate in CANDIDATES if (light := candidate(touches)) is not None), DESCRIBED)


def fit_touch(model: IlluminationModel, touch: Touch) -> Illumination:
    """The light of one touch in the model of its recording; the described light where the touch determines none."""
    found = _fit_field(touch)[0] if model == "field" else _fit_shadow_leds(touch)
    return pack_leds(model, found) or DESCRIBED


def _try_fitted_leds(touches: Sequence[Touch]) -> Illumination | None:
    """LEDs of a usual instance: most simulated touches."""
    return pack_leds("leds", fit_leds(touches[0].source, [touch.observe(touch.described[0]) for touch in touches]))


def _try_field(touches: Sequence[Touch]) -> Illumination | None:
    """A shading field for each touch, if it explains far more than the described light: a real GelSight Mini."""
    if casts_shadows(touches[0].source):
        return None
    decisive = touches[: CONSTANTS.field_touches]
    described = sum(touch.described[1] for touch in decisive)
    fits = [_fit_field(touch, touch.described[1] if len(touches) == 1 else math.inf) for touch in decisive]
    if described <= CONSTANTS.field_gain * sum(fit[1] for fit in fits):
        return None
    return pack_leds("field", fits[0][0]) if len(touches) == 1 else Illumination(model="field")


def _fit_field(touch: Touch, described_misfit: float = math.inf) -> tuple[Doubles | None, float]:
    """Coefficients (m,) of the shading field of one touch and its misfit; none and infinity where it has none."""
    integrate = touch.make_integrator(touch.patch)
    fit = fit_field(touch.guess_mm, touch.patch, touch.source, integrate, described_misfit)
    return (None, math.inf) if fit is None else fit


def _try_near_leds(touches: Sequence[Touch]) -> Illumination | None:
    """The described LEDs, close to the gel, where they leave much as described: a real GelSlim."""
    if casts_shadows(touches[0].source) or _is_explained(touches, sum(touch.described[1] for touch in touches)):
        return None
    return Illumination(model="near")


def _try_trusted_light(touches: Sequence[Touch]) -> Illumination | None:
    """The described LEDs, where they explain the touches once each pixel counts by its certainty."""
    misfit = sum(touch.refine(TRUSTED, touch.described[0])[1] for touch in touches)
    return TRUSTED if _is_explained(touches, misfit) else None


def _try_shadow_leds(touches: Sequence[Touch]) -> Illumination | None:
    """Low LEDs that cast shadows, if the described light leaves most of the change: a real DIGIT."""
    described = sum(touch.described[1] for touch in touches)
    if not casts_shadows(touches[0].source) or _is_explained(touches, described):
        return None
    if len(touches) == 1:
        return pack_leds("shadow_leds", _fit_shadow_leds(touches[0]))
    return Illumination(model="shadow_leds")


def _fit_shadow_leds(touch: Touch) -> Doubles | None:
    """Deviations (m,) of the low LEDs of one touch."""
    return fit_shadow_leds(touch.source, touch.observe(touch.guess_mm))


CANDIDATES = (_try_fitted_leds, _try_field, _try_near_leds, _try_trusted_light, _try_shadow_leds)


def _is_explained(touches: Sequence[Touch], misfit: float) -> bool:
    """Whether a misfit is a small part of the touches' change."""
    change = sum(sum_change_grey(touch.patch, touch.patch.unmarked_share) for touch in touches)
    return misfit <= CONSTANTS.explained_share * change


def pack_leds(model: IlluminationModel, parameters: Doubles | None) -> Illumination | None:
    """A fitted illumination; None where the fit was rejected."""
    return None if parameters is None else Illumination(model=model, parameters=tuple(parameters.tolist()))


def get_optics(illumination: Illumination, source: SensorSpec) -> Optics:
    """The optics of the LEDs: fitted, or as described."""
    described = optics.require_optics(source)
    return (
        led_light.shift_optics(described, np.array(illumination.parameters))
        if illumination.model == "leds"
        else described
    )


def make_light(illumination: Illumination, patch: ImagePatch, source: SensorSpec) -> Light:
    """The illumination as light over a patch."""
    parameters = np.array(illumination.parameters)
    if illumination.model == "field":
        return make_field_light(parameters, patch, source)
    if illumination.model == "shadow_leds":
        leds = shadow_light.shift_leds(shadow_light.make_described_leds(source), parameters)
        return shadow_light.make_shadow_light(source, leds, patch)
    is_near = illumination.model == "near"
    return led_light.make_led_light(
        source, get_optics(illumination, source), patch, trusted=illumination.is_trusted, near=is_near
    )


def correct_surface(
    surface_mm: Floats, patch: ImagePatch, source: SensorSpec, illumination: Illumination, integrate: Integrator
) -> Floats:
    """The surface (rows, cols) in mm of a patch, corrected in an illumination from a first guess."""
    iterations = CONSTANTS.iterations
    light = make_light(illumination, patch, source)
    if illumination.is_trusted:
        plain = led_light.make_led_light(source, get_optics(illumination, source), patch, trusted=False)
        surface_mm, _ = refine_surface(surface_mm, patch, plain, integrate, iterations, until_settled=True)
        iterations *= CONSTANTS.trusted_iteration_factor
    return refine_surface(surface_mm, patch, light, integrate, iterations, until_settled=True)[0]


def add_detail(
    surface_mm: Floats, patch: ImagePatch, source: SensorSpec, illumination: Illumination, integrate: Integrator
) -> Floats:
    """The surface (rows, cols) after one more iteration, at the image's own resolution."""
    light = make_light(illumination, patch, source)
    return refine_surface(surface_mm, patch, light, integrate, 1, CONSTANTS.fine_cg_steps)[0]


def casts_shadows(source: SensorSpec) -> bool:
    """Whether dents cast shadows: LEDs that stand low and away, whose light is even."""
    return optics.require_optics(source).shadow > 0
