"""Choice of the light model of a sensor instance from its touches, and correction of a surface in
that light.

`docs/illumination.md` says which recordings need which.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.core.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import LIGHT, SURFACE
from pipeline.stages.depth.illumination import led_light
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
from pipeline.stages.depth.illumination.parameter_fit import LedObservation, fit_leds
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
        trusted = illumination.is_trusted
        iterations = SURFACE.trusted_iterations if trusted else LIGHT.iterations
        light = make_light(illumination, self.patch, self.source)
        integrate = self.make_integrator(self.patch)
        return refine_surface(start_mm, self.patch, light, integrate, iterations, SURFACE)

    def observe(self, surface_mm: Floats) -> LedObservation:
        """The touch with a surface (rows, cols), on the coarser grid of the LED fit."""
        # half the refinement grid determines the LEDs as well
        cells = downsample_patch(self.patch, self.source.camera.shape, SURFACE.grid_cells // 2)
        if cells is not self.patch:
            surface_mm = compute_cell_means(
                surface_mm, cells.downsampling // self.patch.downsampling
            )
        return LedObservation(
            patch=cells, surface_mm=surface_mm, integrate=self.make_integrator(cells)
        )


def choose_illumination(touches: Sequence[Touch]) -> Illumination:
    """The light that explains the touches of one sensor instance.

    The described light where none does.

    A model whose parameters differ from place to place has none for several touches: `fit_touch`
    finds those of each.
    """
    source = touches[0].source
    leds = _fit_leds(touches)
    if leds is not None:  # of a usual instance: most simulated touches
        return leds
    is_explained = _is_explained(touches, sum(touch.described[1] for touch in touches))
    field = None if is_explained and casts_shadows(source) else _try_field(touches)
    if field is not None:
        return field
    if is_explained:  # the described LEDs hold, once each pixel counts by its certainty
        misfit = sum(touch.refine(TRUSTED, touch.described[0])[1] for touch in touches)
        return TRUSTED if _is_explained(touches, misfit) else DESCRIBED
    # LEDs close to the gel: a real GelSlim
    return DESCRIBED if casts_shadows(source) else Illumination(model="near")


def _fit_leds(touches: Sequence[Touch]) -> Illumination | None:
    """LEDs of a usual instance that explain the touches, if there are any."""
    observed = [touch.observe(touch.described[0]) for touch in touches]
    return pack_leds("leds", fit_leds(touches[0].source, observed))


def choose_for_recording(touches: Sequence[Touch]) -> Illumination | None:
    """The light that holds for all touches of a recording; None where each has its own.

    Cast shadows differ from press to press by more than one choice allows: simulated recordings of
    a DIGIT, .8 mm deep, err by 52 um in place of 47. So where LEDs cast them, it holds if it is
    fitted LEDs, or a field which no touch alone denies.
    """
    light = choose_illumination(touches)
    holds = light.model == "leds" or not casts_shadows(touches[0].source)
    if light.model == "field" and not holds:
        holds = not any(_fit_leds([touch]) for touch in touches[: LIGHT.field_touches])
    return replace(light, from_context=True) if holds else None


def fit_touch(touch: Touch) -> Illumination:
    """The shading field of one touch of a recording.

    The described light where the touch determines none.
    """
    return pack_leds("field", _fit_field(touch)[0]) or DESCRIBED


def _try_field(touches: Sequence[Touch]) -> Illumination | None:
    """A shading field for each touch, if it explains far more than the described light: a real
    GelSight Mini.

    Where LEDs cast shadows, which no field explains, more is enough: a real DIGIT.
    """
    decisive = touches[: LIGHT.field_touches]
    described = sum(touch.described[1] for touch in decisive)
    alone = len(touches) == 1
    fits = [_fit_field(touch, touch.described[1] if alone else math.inf) for touch in decisive]
    gain = 1.0 if casts_shadows(touches[0].source) else LIGHT.field_gain
    if described <= gain * sum(fit[1] for fit in fits):
        return None
    return pack_leds("field", fits[0][0]) if alone else Illumination(model="field")


def _fit_field(touch: Touch, described_misfit: float = math.inf) -> tuple[Doubles | None, float]:
    """Coefficients (m,) of the shading field of one touch and its misfit.

    None and infinity where it has none.
    """
    integrate = touch.make_integrator(touch.patch)
    fit = fit_field(touch.guess_mm, touch.patch, touch.source, integrate, described_misfit)
    return (None, math.inf) if fit is None else fit


def _is_explained(touches: Sequence[Touch], misfit: float) -> bool:
    """Whether a misfit is a small part of the touches' change."""
    change = sum(sum_change_grey(touch.patch) for touch in touches)
    return misfit <= LIGHT.explained_share * change


def pack_leds(model: IlluminationModel, parameters: Doubles | None) -> Illumination | None:
    """A fitted illumination; None where the fit was rejected."""
    return (
        None
        if parameters is None
        else Illumination(model=model, parameters=tuple(parameters.tolist()))
    )


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
    is_near = illumination.model == "near"
    return led_light.make_led_light(
        source,
        get_optics(illumination, source),
        patch,
        trusted=illumination.is_trusted,
        near=is_near,
    )


def correct_surface(
    surface_mm: Floats,
    patch: ImagePatch,
    source: SensorSpec,
    illumination: Illumination,
    integrate: Integrator,
) -> Floats:
    """The surface (rows, cols) in mm of a patch, corrected in an illumination from a first
    guess.
    """
    light = make_light(illumination, patch, source)
    iterations = SURFACE.iterations
    if illumination.is_trusted:
        described = get_optics(illumination, source)
        plain = led_light.make_led_light(source, described, patch, trusted=False)
        surface_mm, _ = refine_surface(
            surface_mm, patch, plain, integrate, SURFACE.first_iterations, SURFACE
        )
        iterations = SURFACE.trusted_iterations
    return refine_surface(
        surface_mm, patch, light, integrate, iterations, SURFACE, until_settled=True
    )[0]


def add_walls(
    surface_mm: Floats,
    patch: ImagePatch,
    source: SensorSpec,
    illumination: Illumination,
    integrate: Integrator,
) -> Floats:
    """The surface (rows, cols) with its walls raised at the image's own resolution, where they are
    steeper.
    """
    light = make_light(illumination, patch, source)
    settings = replace(SURFACE, cg_steps=SURFACE.fine_cg_steps)
    return refine_surface(surface_mm, patch, light, integrate, 1, settings)[0]


def casts_shadows(source: SensorSpec) -> bool:
    """Whether dents cast shadows: LEDs that stand low and away, whose light is even."""
    return optics.require_optics(source).shadow > 0
