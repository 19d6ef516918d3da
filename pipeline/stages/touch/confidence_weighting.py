"""Confidence weighting: shrinks a network's correction toward physics, pixel by pixel, where its
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

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.stages.touch.residual_diffusion import DenoisingState, ResidualSample
from pipeline.stages.touch.residual_render import resample_to_grid

_BLUR_PX = 4.0  # px; a share with finer structure would create edges
_HALF = 0.5


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
