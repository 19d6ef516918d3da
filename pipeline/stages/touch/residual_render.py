"""Renders a membrane with a correction as the touch that the target sensor would record.

Confidence weighting: shrinks a network's correction toward physics, pixel by pixel, where its
error is large.

A correction as large as its expected error is taken by half, a much larger one almost completely.
The expected error is trained on held-out touches and calibrated on others, separately inside and
outside the source's view: on new objects a network is over-confident. Predicted errors can also be
too uniform (small ones too large, large ones too small), so that weights carry an exponent besides
the factors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

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


_BLUR_PX = 4.0  # px; a share with finer structure would create edges


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCalibration:
    """Calibration of a network's predicted error."""

    factor_in_view: float  # factor of the predicted error inside the source's view
    factor_outside: float
    exponent: float = 1.0  # exponent of that error, in `unit_mm`
    unit_mm: float = 1.0

    def calibrate_error_mm(self, predicted_error_mm: Floats, in_view: Mask) -> Floats:
        """Expected error (rows, cols) for a predicted error."""
        factor = np.where(in_view, np.float32(self.factor_in_view), np.float32(self.factor_outside))
        return (
            factor
            * predicted_error_mm
            * (predicted_error_mm / np.float32(self.unit_mm)) ** np.float32(self.exponent - 1.0)
        ).astype(np.float32)


def read_error_calibration(network: Any) -> ErrorCalibration:
    """The calibration in the weights of a `residual_denoiser`."""
    in_view_factor, outside_factor = network.error_factors
    return ErrorCalibration(
        factor_in_view=in_view_factor,
        factor_outside=outside_factor,
        exponent=network.error_exponent,
        unit_mm=network.unit_mm,
    )


def shrink_to_prior(
    sample: ResidualSample,
    in_view: Mask,
    confidence_weighting: float,
    calibration: ErrorCalibration,
    *,
    shrinks_contact: bool = True,
) -> ResidualSample:
    """Shrink a posterior mean toward physics; `in_view` is where the source sees.

    `confidence_weighting` 0 keeps the full correction, 1 applies the whole Wiener gain. Contact is
    shrunk as the membrane in view, and by the root of the share outside, where nothing else is
    known (overlap 0.473 instead of 0.460 without shrinking, on 160 touches outside the tables).
    Without `shrinks_contact` the prior's contact is kept in view.
    """
    mean = sample.final.residual_mm
    spread = sample.expected_error_mm
    is_in_view = resample_to_grid(in_view, mean.shape) > _HALF
    share = 1.0 - confidence_weighting * (
        1.0 - compute_wiener_gain(mean, calibration.calibrate_error_mm(spread, is_in_view))
    )
    contact_share = np.where(
        is_in_view,
        share if shrinks_contact else np.float32(1.0 - confidence_weighting),
        np.sqrt(share),
    )

    def shrink_state(state: DenoisingState) -> DenoisingState:
        residual = (share * state.residual_mm).astype(np.float32)
        return replace(
            state,
            residual_mm=freeze(residual),
            contact_correction=freeze(
                (contact_share * state.contact_correction).astype(np.float32)
            ),
        )

    return replace(
        sample,
        final=shrink_state(sample.final),
        states=tuple(shrink_state(state) for state in sample.states),
    )


def compute_wiener_gain(correction_mm: Floats, error_mm: Floats) -> Floats:
    """Share 0..1 (rows, cols) of a correction with this expected error: m^2 / (m^2 + s^2),
    smoothed.
    """
    signal, noise = (_blur(np.square(f, dtype=np.float32)) for f in (correction_mm, error_mm))
    return np.where(
        noise > 0.0, signal / np.maximum(signal + noise, np.float32(1e-12)), np.float32(1.0)
    )


def _blur(field: Floats) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), _BLUR_PX), np.float32)
