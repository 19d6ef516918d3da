"""Choice of the light model of one touch, and correction of its surface in that light.

The candidates are tried in the order of `CANDIDATES`; the first that explains the image is taken, and the described
light where none does. `docs/illumination.md` says which recordings need which.
"""

from collections.abc import Callable
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """One touch whose light is to be chosen."""

    guess_mm: Floats  # (rows, cols) surface by the calibration table
    described_mm: Floats  # (rows, cols) surface in the described light
    described_misfit: float
    patch: ImagePatch
    source: SensorSpec
    make_integrator: IntegratorFactory

    def compute_misfit(self, illumination: Illumination, start_mm: Floats) -> float:
        """What an illumination leaves of the image."""
        return _refine(start_mm, self.patch, self.source, illumination, self.make_integrator(self.patch))[1]

    def is_explained(self, misfit: float) -> bool:
        """Whether a misfit is a small part of the change."""
        return misfit <= CONSTANTS.explained_share * sum_change_grey(self.patch, self.patch.unmarked_share)


def choose_illumination(
    guess_mm: Floats, patch: ImagePatch, source: SensorSpec, make_integrator: IntegratorFactory
) -> Illumination:
    """The light that explains a touch: the first candidate that does, else the described light."""
    surface, misfit = _refine(guess_mm, patch, source, DESCRIBED, make_integrator(patch))
    touch = Touch(
        guess_mm=guess_mm, described_mm=surface, described_misfit=misfit, patch=patch, source=source,
        make_integrator=make_integrator,
    )  # fmt: skip
    return next((light for candidate in CANDIDATES if (light := candidate(touch)) is not None), DESCRIBED)


def _try_fitted_leds(touch: Touch) -> Illumination | None:
    """LEDs of a usual instance: most simulated touches."""
    observation = make_led_observation(touch.described_mm, touch.patch, touch.source, touch.make_integrator)
    return pack_leds("leds", fit_leds(touch.source, [observation]))


def _try_field(touch: Touch) -> Illumination | None:
    """A shading field, if it explains far more than the described light: a real GelSight Mini."""
    if _casts_shadows(touch.source):
        return None
    integrate = touch.make_integrator(touch.patch)
    fit = fit_field(touch.guess_mm, touch.patch, touch.source, integrate, touch.described_misfit)
    if fit is None or touch.described_misfit <= CONSTANTS.field_gain * fit[1]:
        return None
    return pack_leds("field", fit[0])


def _try_near_leds(touch: Touch) -> Illumination | None:
    """The described LEDs, close to the gel: most touches of real GelSlims."""
    near = Illumination(model="near")
    if _casts_shadows(touch.source):
        return None
    misfit = touch.compute_misfit(near, touch.guess_mm)
    return near if touch.described_misfit > CONSTANTS.near_gain * misfit else None


def _try_trusted_light(touch: Touch) -> Illumination | None:
    """The described LEDs, where they explain the image once each pixel counts by its certainty."""
    return TRUSTED if touch.is_explained(touch.compute_misfit(TRUSTED, touch.described_mm)) else None


def _try_shadow_leds(touch: Touch) -> Illumination | None:
    """Low LEDs that cast shadows, if the described light leaves most of the change: a real DIGIT."""
    if not _casts_shadows(touch.source) or touch.is_explained(touch.described_misfit):
        return None
    observation = make_led_observation(touch.guess_mm, touch.patch, touch.source, touch.make_integrator)
    return pack_leds("shadow_leds", fit_shadow_leds(touch.source, observation))


CANDIDATES = (_try_fitted_leds, _try_field, _try_near_leds, _try_trusted_light, _try_shadow_leds)


def make_led_observation(
    surface_mm: Floats, patch: ImagePatch, source: SensorSpec, make_integrator: IntegratorFactory
) -> LedObservation:
    """One touch on the coarser grid of the LED fit."""
    cells = downsample_patch(patch, source.camera.shape, CONSTANTS.led_grid_cells)
    if cells is not patch:
        surface_mm = compute_cell_means(surface_mm, cells.downsampling // patch.downsampling)
    return LedObservation(patch=cells, surface_mm=surface_mm, integrate=make_integrator(cells))


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
    surface_mm: Floats, patch: ImagePatch, source: SensorSpec, illumination: Illumination, integrate: Integrator, *,
    draft: bool,
) -> Floats:  # fmt: skip
    """The surface (rows, cols) in mm of a patch, corrected in an illumination from a first guess."""
    iterations = CONSTANTS.draft_iterations if draft else CONSTANTS.iterations
    light = make_light(illumination, patch, source)
    if illumination.is_trusted and not draft:
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


def _refine(
    surface_mm: Floats, patch: ImagePatch, source: SensorSpec, illumination: Illumination, integrate: Integrator
) -> tuple[Floats, float]:
    factor = CONSTANTS.trusted_iteration_factor if illumination.is_trusted else 1
    light = make_light(illumination, patch, source)
    return refine_surface(surface_mm, patch, light, integrate, factor * CONSTANTS.iterations)


def _casts_shadows(source: SensorSpec) -> bool:
    """Whether dents cast shadows: LEDs that stand low and away, whose light is even."""
    return optics.require_optics(source).shadow > 0
