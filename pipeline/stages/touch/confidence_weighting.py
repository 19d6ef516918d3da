"""Where a network is unsure, what it corrects is left as it is: how much of a correction is taken, pixel by pixel.

A correction that is as small as the error expected of it is half taken, one that is far larger nearly all. What is
expected was learned from touches that nothing else was learned from; how much larger the error has to be taken for is
chosen by `benchmarks/confidence_weighting.py`, where the source felt something and beyond: of objects that it has never seen a
network is surer than it should be. What it tells may be squeezed together, too: where little is told nearly nothing is
wrong, and where much is told far more. Weights therefore carry a power of it beside how many times it counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.stages.touch.residual_diffusion import DenoisingState, ResidualSample
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.values.results import DepthMap

_EVEN_PX = 4.0  # a share that changed faster would draw edges of its own
_HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCalibration:
    """How far off a network has to be taken for by what it tells of its own error."""

    factor_in_view: float  # how many times that error counts where the source felt
    factor_outside: float
    exponent: float = 1.0  # of that error, in `unit_mm`
    unit_mm: float = 1.0

    def calibrate_error_mm(self, predicted_error_mm: Floats, in_view: Mask) -> Floats:
        """(rows, cols) what is to be expected where the network tells `told_mm`."""
        times = np.where(in_view, np.float32(self.factor_in_view), np.float32(self.factor_outside))
        return (
            times
            * predicted_error_mm
            * (predicted_error_mm / np.float32(self.unit_mm)) ** np.float32(self.exponent - 1.0)
        ).astype(np.float32)


def read_error_calibration(network: Any) -> ErrorCalibration:
    """As the weights of a `residual_denoiser` have it."""
    felt, beyond = network.error_factors
    return ErrorCalibration(
        factor_in_view=felt, factor_outside=beyond, exponent=network.error_exponent, unit_mm=network.unit_mm
    )


def shrink_to_prior(
    sample: ResidualSample,
    in_view: Mask,
    confidence_weighting: float,
    calibration: ErrorCalibration,
    *,
    shrinks_contact: bool = True,
) -> ResidualSample:
    """A middle of all samples, of which only what is sure is taken; `known` is where the source felt.

    `caution` 0 takes all of it, 1 holds back by all that is `trusted` no further. Contact is held back as the membrane
    is where the source felt, and less so beyond, where nothing else is known of it (the root of the share: overlap
    0.473 instead of 0.460 with all of it, on 160 touches that are in no table). Without `contact` that of the first
    answer stays where the source felt.
    """
    middle, spread = sample.final.residual_mm, sample.expected_error_mm
    within = resample_to_grid(in_view, middle.shape) > _HALF
    share = 1.0 - confidence_weighting * (
        1.0 - compute_wiener_gain(middle, calibration.calibrate_error_mm(spread, within))
    )
    of_contact = np.where(within, share if shrinks_contact else np.float32(1.0 - confidence_weighting), np.sqrt(share))

    def shrink_state(state: DenoisingState) -> DenoisingState:
        residual = (share * state.residual_mm).astype(np.float32)
        return replace(
            state, residual_mm=freeze(residual), contact_correction=freeze((of_contact * state.contact_correction).astype(np.float32))
        )  # fmt: skip

    return replace(
        sample, final=shrink_state(sample.final), states=tuple(shrink_state(state) for state in sample.states)
    )


def compute_error_ratio(sample: ResidualSample, contact: Mask) -> float:
    """How many times farther than it expects a network is from what the source felt itself; 0 where it felt nothing."""
    off, expected = np.abs(sample.final.residual_mm), sample.expected_error_mm
    there = resample_to_grid(contact, off.shape) > _HALF
    return float(off[there].mean() / max(float(expected[there].mean()), 1e-9)) if there.any() else 0.0


def compute_wiener_gain(correction_mm: Floats, error_mm: Floats) -> Floats:
    """The share 0..1 of a correction (rows, cols) that is expected to be off by so much."""
    large, wrong = (_even(np.square(f, dtype=np.float32)) for f in (correction_mm, error_mm))
    return np.where(wrong > 0.0, large / np.maximum(large + wrong, np.float32(1e-12)), np.float32(1.0))


def _even(field: Floats) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), _EVEN_PX), np.float32)


def express_as_correction(sample: ResidualSample, first: DepthMap) -> ResidualSample:
    """The same touch told as a correction of `first`; until now it was one of the untouched target."""
    shape = sample.expected_error_mm.shape
    deep, touched = resample_to_grid(first.indentation_mm, shape), resample_to_grid(first.contact, shape)

    def subtract_first(state: DenoisingState) -> DenoisingState:
        return replace(
            state, residual_mm=freeze(state.residual_mm - deep), contact_correction=freeze(state.contact_correction - touched)
        )  # fmt: skip

    return replace(
        sample, final=subtract_first(sample.final), states=tuple(subtract_first(state) for state in sample.states)
    )
