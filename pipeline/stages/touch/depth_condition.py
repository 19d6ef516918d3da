"""Input of the T2D2 networks, for training and inference.

The compact denoiser gets physical render, contact, view, and fine relief on the working grid;
latent diffusion gets the target depth, its contact mask and the source's view as a square.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks.touch_formats import get_touch_format, resize_to_square

CONDITION_CHANNELS = 6


def make_working_sensor(target: SensorSpec) -> SensorSpec:
    """The target with the camera of the working grid."""
    factor = get_touch_format(target.kind).grid_factor
    return target if factor == 1 else target.with_camera(target.camera.scale(1.0 / factor))


def build_depth_condition(
    kind: str,
    indentation_mm: Floats,
    contact: Mask,
    in_view: Mask,
    physical_mm: Floats,
    physical_contact: Mask,
) -> Floats:
    """(CONDITION_CHANNELS, rows, cols) float32 for a target of that kind.

    All arguments on the working grid.
    """
    known = get_touch_format(kind)
    deepest = float(indentation_mm[contact].max()) if contact.any() else 0.0
    lowest = np.float32(-known.max_relief_mm)
    relief = np.where(contact, np.clip(indentation_mm - deepest, lowest, 0.0), lowest)
    return freeze(
        np.stack(
            [
                physical_mm / known.indentation_unit_mm,
                np.where(contact, indentation_mm, 0.0) / known.indentation_unit_mm,
                relief / known.relief_unit_mm,
                contact,
                in_view,
                physical_contact,
            ]
        ).astype(np.float32)
    )


def build_depth_square(
    kind: str, indentation_mm: Floats, contact: Mask, in_view: Mask, side: int
) -> Floats:
    """(3, side, side) of the target depth's fields (rows, cols): indentation in contact,
    contact, the source's view.
    """
    indentation = np.where(contact, indentation_mm, np.float32(0.0)) / np.float32(
        get_touch_format(kind).indentation_unit_mm
    )
    return resize_to_square(
        np.stack([indentation, contact, in_view], axis=-1).astype(np.float32), side
    )
