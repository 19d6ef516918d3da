"""The gels' network run by OpenCV and numpy: the same answers as by torch to a millionth of them, without loading it.

The U-Net is OpenCV's (`compact_unet_opencv`); what `gel_reading` makes of its fields is said there, and done here again
in numpy: gradients do not pass through it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft

from pipeline.base.arrays import Floats, freeze
from pipeline.networks.compact_unet_opencv import CompactUnetOpenCv
from pipeline.networks.weights import Weights

SLOPE_UNIT_PX = 8.0  # pixels in which slopes are told
COARSE_SCALE = 0.25  # brings the rough correction to the order of 1
MAX_CORRECTION, MAX_CORRECTION_SHARE = 0.08, 0.35  # that is added: of the depth, and of the height at the place
LOG_SHARE_SCALE, LOG_SHARE_MIN, LOG_SHARE_MAX = (
    0.5,
    -8.0,
    4.0,
)  # brings the logarithm of a share of slopes to the order of 1; its ends
LOG_FACTOR_SCALE, LOG_FACTOR_LIMIT = (
    0.3,
    1.0,
)  # of the scale's logarithm: brings it to the order of 1, and as far as it goes
NON_CONTACT_WEIGHT = 1e-3  # of a pixel's say in it, beside the contact
LOG_ERROR_MIN, LOG_ERROR_MAX = -6.0, 3.0  # logarithm
OUTPUTS = 6  # and one more of a network that tells the scale
_BODY = "body."


class GelDepthCorrection(NamedTuple):
    """Each (rows, cols) float32; heights in depths of the physical contact."""

    correction: Floats  # to be added to physics, positive toward the camera
    contact_logit_correction: Floats  # logit, beside what physics holds
    log_error_scale: Floats  # logarithm of the Laplace scale of the corrected surface, of its product with the factor
    log_depth_factor: float | None = None  # logarithm of the factor that makes that surface true; None: it is not told


class GelDepthNetworkOpenCv:
    """What a picture's fields (inputs, rows, cols), float32, show; threads may share it."""

    def __init__(
        self, weights: Weights, *, inputs: int, physics_channel: int, base_channels: int = 32, levels: int = 4, max_channels: int = 120,
        reach_px: float = 25.0, calibrated: bool = False, predicts_depth_factor: bool = False,
    ) -> None:  # fmt: skip
        """`GelReading`'s own arguments; raises ValueError where the tensors do not fit them."""
        others = [name for name in weights.tensors if not name.startswith(_BODY)]
        if others:
            raise ValueError(f"{len(others)} tensors are none of its own, such as {others[0]!r}")
        body = {name.removeprefix(_BODY): tensor for name, tensor in weights.tensors.items()}
        self._body = CompactUnetOpenCv(
            replace(weights, tensors=body), inputs=inputs, outputs=OUTPUTS + predicts_depth_factor, base_channels=base_channels, levels=levels,
            max_channels=max_channels,
        )  # fmt: skip
        self.inputs, self.physics_channel, self.reach_px = inputs, physics_channel, reach_px
        self.calibrated, self.predicts_depth_factor = calibrated, predicts_depth_factor

    def __call__(self, fields: Floats) -> GelDepthCorrection:
        """As `GelReading` answers for one picture."""
        told = self._body(fields)
        rough, more_x, more_y, factor, more_contact, log_spread = told[:OUTPUTS]
        slope_x, slope_y, deep, pressed = fields[self.physics_channel : self.physics_channel + 4]
        share = np.expm1(np.float32(LOG_SHARE_SCALE) * np.clip(factor, LOG_SHARE_MIN, LOG_SHARE_MAX))
        wanted = _integrated(
            (share * slope_x + more_x) / np.float32(SLOPE_UNIT_PX), (share * slope_y + more_y) / np.float32(SLOPE_UNIT_PX),
            np.float32(COARSE_SCALE) * rough, self.reach_px,
        )  # fmt: skip
        most = np.float32(MAX_CORRECTION) + np.float32(MAX_CORRECTION_SHARE) * np.clip(deep, 0.0, 1.5)
        return GelDepthCorrection(
            correction=most * np.tanh(wanted / most), contact_logit_correction=more_contact,
            log_error_scale=np.clip(log_spread, LOG_ERROR_MIN, LOG_ERROR_MAX),
            log_depth_factor=_over(pressed, told[OUTPUTS]) if self.predicts_depth_factor else None,
        )  # fmt: skip


def _over(pressed: Floats, log_factor: Floats) -> float:
    say = np.maximum(pressed, 0.0).astype(np.float64) + NON_CONTACT_WEIGHT
    return float(
        np.clip(
            LOG_FACTOR_SCALE * float((log_factor * say).sum()) / float(say.sum()), -LOG_FACTOR_LIMIT, LOG_FACTOR_LIMIT
        )
    )


def _integrated(slope_x: Floats, slope_y: Floats, rough: Floats, reach: float) -> Floats:
    """`gel_reading.integrated` of one picture."""
    edges_x = np.float32(0.5) * (slope_x[:, 1:] + slope_x[:, :-1])
    edges_y = np.float32(0.5) * (slope_y[1:] + slope_y[:-1])
    right = np.float32(1.0 / reach**2) * rough
    right[:, 1:] += edges_x
    right[:, :-1] -= edges_x
    right[1:] += edges_y
    right[:-1] -= edges_y
    wave = np.asarray(fft.dctn(right, norm="ortho"), np.float32) * _share(*rough.shape, reach)
    return np.asarray(fft.idctn(wave, norm="ortho", overwrite_x=True), np.float32)


@lru_cache(maxsize=16)
def _share(rows: int, cols: int, reach: float) -> Floats:
    """What divides a wave by its eigenvalue of D'D and the pull."""
    down, across = ((2.0 * np.sin(np.arange(n) * (0.5 * np.pi / n))) ** 2 for n in (rows, cols))
    return freeze((1.0 / (down[:, None] + across[None, :] + 1.0 / reach**2)).astype(np.float32))
