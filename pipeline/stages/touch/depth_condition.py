"""Input of the T2D2 networks, for training and inference.

The compact denoiser gets physical render, contact, view, and fine relief on the working grid; latent diffusion gets the
target depth, its contact mask and the source's view as a square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.engine.digests import compute_cached_digest
from pipeline.networks.square_images import resize_to_square
from pipeline.sensors.spec import SensorSpec

CONDITION_CHANNELS = 6
WORKING_GRID_FACTOR = {"gel": 2, "bubble": 1}  # target pixels per pixel of the working grid


@dataclass(frozen=True, slots=True)
class _Scale:
    coarse_mm: float
    max_relief_mm: float
    fine_mm: float


_SCALES = {"gel": _Scale(0.6, 1.0, 0.25), "bubble": _Scale(6.0, 2.0, 0.5)}


def make_working_sensor(target: SensorSpec) -> SensorSpec:
    """The target with the camera of the working grid."""
    factor = WORKING_GRID_FACTOR[target.kind]
    if factor == 1:
        return target
    return _working_sensors.get_or_make(
        compute_cached_digest(target), lambda: target.with_camera(target.camera.scale(1.0 / factor))
    )


_working_sensors: Memo[str, SensorSpec] = Memo(8)


def build_depth_condition(
    kind: str, indentation_mm: Floats, contact: Mask, in_view: Mask, physical_mm: Floats, physical_contact: Mask
) -> Floats:
    """(CONDITION_CHANNELS, rows, cols) float32 for a target of that kind; all arguments on the working grid."""
    scale = _SCALES[kind]
    deepest = float(indentation_mm[contact].max()) if contact.any() else 0.0
    lowest = np.float32(-scale.max_relief_mm)
    relief = np.where(contact, np.clip(indentation_mm - deepest, lowest, 0.0), lowest)
    return freeze(np.stack([
        physical_mm / scale.coarse_mm, np.where(contact, indentation_mm, 0.0) / scale.coarse_mm, relief / scale.fine_mm,
        contact, in_view, physical_contact,
    ]).astype(np.float32))  # fmt: skip


def build_depth_square(kind: str, indentation_mm: Floats, contact: Mask, in_view: Mask, side: int) -> Floats:
    """(3, side, side) of the target depth's fields (rows, cols): indentation in contact, contact, the source's view."""
    indentation = np.where(contact, indentation_mm, np.float32(0.0)) / np.float32(_SCALES[kind].coarse_mm)
    return resize_to_square(np.stack([indentation, contact, in_view], axis=-1).astype(np.float32), side)
