"""Renders a membrane with a correction as the touch that the target sensor would record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Floats, Image, Mask, freeze
from pipeline.core.errors import ChangeNote, OutsideViewWarning
from pipeline.core.graph import Fallback
from pipeline.core.values.results import DepthMap, GeneratedTouch, TouchStep
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.touch.residual_diffusion import DenoisingState, ResidualSample

_HALF = 0.5
NO_STEPS = "physics: no denoising step"
NO_PRIOR_CONTACT = "physics: the render has no contact that the network could correct"
NO_CHANGE = (
    "physics: the network changes nothing; its corrections are smaller than their expected errors"
)


def render_correction(
    first: GeneratedTouch, target: SensorSpec, sample: ResidualSample, seed: int | None
) -> GeneratedTouch:
    """`first` with a sample's correction, resampled from the working grid to the target's pixels.

    The membrane is limited to the sensor's maximum indentation. `seed` sets the sensor noise, None
    = no noise. The whole image is in view; `membrane.expected_error_mm` holds the uncertainty.
    Warnings of what physics leaves out are dropped.
    """
    prior_membrane = first.membrane
    assert prior_membrane is not None
    error_mm = freeze(_resize(sample.expected_error_mm, target.camera.shape))
    image, corrected = _render_state(prior_membrane, target, sample.final, seed)
    steps = [
        TouchStep(image=rendered, sigma=state.sigma, membrane=membrane)
        for state in sample.states
        for rendered, membrane in (_render_state(prior_membrane, target, state, None),)
    ]
    return replace(
        first,
        image=image,
        membrane=replace(corrected, expected_error_mm=error_mm),
        in_view=freeze(np.ones(target.camera.shape, np.bool_)),
        notes=(
            *(note for note in first.notes if not isinstance(note, OutsideViewWarning)),
            *sample.notes,
        ),
        steps=tuple(steps),
    )


def _render_state(
    first: DepthMap, target: SensorSpec, state: DenoisingState, seed: int | None
) -> tuple[Image | Floats, DepthMap]:
    shape = target.camera.shape
    surface = first.indentation_mm + _resize(state.residual_mm, shape)
    surface = np.minimum(surface, np.float32(target.limits.indentation_max_mm)).astype(np.float32)
    contact: Mask = (
        first.contact.astype(np.float32) + _resize(state.contact_correction, shape) > _HALF
    )
    depth: Floats = (target.rest_depth_mm - surface).astype(np.float32)
    corrected = replace(
        first,
        indentation_mm=freeze(surface),
        depth_mm=freeze(depth),
        contact=freeze(contact),
        is_generated=True,
    )
    return render_sensor_image(target, surface, depth, seed), corrected


def report_change(
    touch: GeneratedTouch, physical: GeneratedTouch
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    """`touch` with a note of what the network changed.

    A fallback where image and contact equal those of physics.

    The note holds the mean distance from physics in contact, or the number of pixels where only the
    contact differs.
    """
    assert touch.membrane is not None
    assert physical.membrane is not None
    n_contact_changes = np.count_nonzero(touch.membrane.contact != physical.membrane.contact)
    if np.array_equal(touch.image, physical.image):
        if not n_contact_changes:
            notes = tuple(dict.fromkeys((*physical.notes, *touch.notes)))
            return Fallback(result=replace(physical, notes=notes), reason=NO_CHANGE)
        return replace(
            touch,
            notes=(*touch.notes, ChangeNote(f"network changed contact by {n_contact_changes} px")),
        )
    contact = touch.membrane.contact | physical.membrane.contact
    change_mm = np.abs(touch.membrane.indentation_mm - physical.membrane.indentation_mm)[contact]
    note = ChangeNote(
        f"network changed {float(change_mm.mean()) if change_mm.size else 0.0:.2g} mm"
    )
    return replace(touch, notes=(*touch.notes, note))


def resample_to_grid(field: Floats | Mask, shape: tuple[int, int]) -> Floats:
    """A field as area means on a coarser grid of the same view."""
    import cv2

    whole = np.asarray(field, np.float32)
    if whole.shape == shape:
        return whole
    return np.asarray(cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _resize(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return np.asarray(field, np.float32)
    return np.asarray(
        cv2.resize(np.array(field), shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32
    )
