"""What the residual denoiser is shown, for its teacher and its user alike; each (channels, rows, cols) float32.

Of a view (touch to depth to touch): the physical render, what was felt and where that could be, and the relief of it,
finer. Of a picture (touch to touch): how the source's reading changed, drawn where the target would see it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.engine.digests import compute_cached_digest
from pipeline.sensors.spec import SensorSpec

CONDITION_CHANNELS = 6
WORKING_GRID_FACTOR = {"gel": 2, "bubble": 1}  # the working grid, in pixels of the target's own


@dataclass(frozen=True, slots=True)
class _Scale:
    coarse_mm: float
    relief_mm: float  # at most
    fine_mm: float


_SCALES = {"gel": _Scale(0.6, 1.0, 0.25), "bubble": _Scale(6.0, 2.0, 0.5)}


def make_working_sensor(target: SensorSpec) -> SensorSpec:
    """The target on the grid that the denoiser works on."""
    coarser = WORKING_GRID_FACTOR[target.kind]
    if coarser == 1:
        return target
    return _coarser.get_or_make(
        compute_cached_digest(target), lambda: target.with_camera(target.camera.scale(1.0 / coarser))
    )


_coarser: Memo[str, SensorSpec] = Memo(8)


def build_depth_condition(
    kind: str, indentation_mm: Floats, contact: Mask, known: Mask, physical_mm: Floats, physical_contact: Mask
) -> Floats:
    """(VIEW_CHANNELS, rows, cols) for a target of that kind; each argument on the working grid."""
    scale = _SCALES[kind]
    deepest = float(indentation_mm[contact].max()) if contact.any() else 0.0
    lowest = np.float32(-scale.relief_mm)
    relief = np.where(contact, np.clip(indentation_mm - deepest, lowest, 0.0), lowest)
    return freeze(np.stack([
        physical_mm / scale.coarse_mm, np.where(contact, indentation_mm, 0.0) / scale.coarse_mm, relief / scale.fine_mm,
        contact, known, physical_contact,
    ]).astype(np.float32))  # fmt: skip
