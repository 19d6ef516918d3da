"""Choice of the light model of a sensor instance from its touches, and correction of a surface in
that light.

`docs/illumination.md` says which recordings need which.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.physics import optics
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import LIGHT, SURFACE
from pipeline.stages.depth.illumination import led_light
from pipeline.stages.depth.illumination.field_light import (
    compute_known_share,
    determines_field,
    fit_field,
    make_field_light,
    sum_covariance,
)
from pipeline.stages.depth.illumination.light import (
    Illumination,
    ImagePatch,
    Light,
    TouchObservation,
    compute_cell_means,
    downsample_patch,
    sum_change_grey,
)
from pipeline.stages.depth.illumination.parameter_fit import fit_leds
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

    def observe(self, surface_mm: Floats) -> TouchObservation:
        """The touch with a surface (rows, cols), on the coarser grid of the LED fit."""
        # half the refinement grid determines the LEDs as well
        cells = downsample_patch(self.patch, self.source.camera.shape, SURFACE.grid_cells // 2)
        if cells is not self.patch:
            surface_mm = compute_cell_means(
                surface_mm, cells.downsampling // self.patch.downsampling
            )
        return TouchObservation(
            patch=cells, surface_mm=surface_mm, integrate=self.make_integrator(cells)
        )


def choose_illumination(touches: Sequence[Touch]) -> Illumination:
    """The light that explains the touches of one sensor instance.

    The described light where none does.

    A shading field of several touches says how far it is known: `adapt_field`.
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
    found = fit_leds(touches[0].source, observed)
    return None if found is None else Illumination(model="leds", parameters=tuple(found.tolist()))


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


def adapt_field(
    field: Illumination,
    dent_mm: Floats,
    source: SensorSpec,
    pixel_mm: float,
    observe: Callable[[], Touch],
) -> Illumination:
    """The shading field of one touch of a recording whose own field is given.

    That of the recording where it is known around the touch's coarse dent (rows, cols), else that
    of the touch, which `observe` makes; gradually.
    """
    share = compute_known_share(field, dent_mm, source, pixel_mm)
    known = replace(field, covariance=())
    if share == 1.0:
        return known
    own = _try_field([observe()], is_chosen=True)
    if own is None or share == 0.0:
        return own or known
    blend = share * np.array(known.parameters) + (1.0 - share) * np.array(own.parameters)
    return replace(own, parameters=tuple(blend.tolist()))


def _try_field(touches: Sequence[Touch], *, is_chosen: bool = False) -> Illumination | None:
    """The shading field of touches, if it explains far more than the described light: a real
    GelSight Mini.

    Where LEDs cast shadows, which no field explains, more is enough: a real DIGIT. None where no
    touch determines one.
    """
    fitted = [touch for touch in touches if determines_field(touch.patch)]
    if not fitted:
        return None
    source = touches[0].source
    described = math.inf if is_chosen else sum(touch.described[1] for touch in fitted)
    guesses = [
        TouchObservation(
            patch=touch.patch,
            surface_mm=touch.guess_mm,
            integrate=touch.make_integrator(touch.patch),
        )
        for touch in fitted
    ]
    fit = fit_field(source, guesses, described)
    gain = 1.0 if casts_shadows(source) else LIGHT.field_gain
    if fit is None or described <= gain * fit.misfit:
        return None
    field = Illumination(model="field", parameters=tuple(fit.coefficients.tolist()))
    if len(touches) == 1:
        return field
    return replace(field, covariance=tuple(sum_covariance(fit.precision).ravel().tolist()))


def _is_explained(touches: Sequence[Touch], misfit: float) -> bool:
    """Whether a misfit is a small part of the touches' change."""
    change = sum(sum_change_grey(touch.patch) for touch in touches)
    return misfit <= LIGHT.explained_share * change


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
