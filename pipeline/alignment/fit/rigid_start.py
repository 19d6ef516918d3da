"""Convert a transfer model in millimetres to a rigid alignment, to be refined in all six directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.alignment.fit.pairs import compute_pixel_mm
from pipeline.alignment.fit.transfer import TransferModel
from pipeline.alignment.touches import AlignmentTouch
from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import SettingProblem
from pipeline.geometry import rigid
from pipeline.sensors.alignment import Alignment
from pipeline.values.results import DepthMap


def align_rigidly(touches: Sequence[AlignmentTouch], how: TransferModel, described: Alignment) -> Alignment:
    """Return the alignment with the in-plane motion of `how` and matching contact depths, stored on the target's side.

    Raises SettingProblem for a mirrored model, which is no rigid motion.
    """
    if how.is_mirrored:
        raise SettingProblem(
            "the images of the two sensors agree only when one is mirrored; flip one sensor's images and try again"
        )
    cos, sin = np.cos(how.rotation_rad), np.sin(how.rotation_rad)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middles = [np.median([_middle_mm(d) for d in side], axis=0) for side in
               ([t.source for t in touches], [t.target for t in touches])]  # fmt: skip
    shift = np.array([how.right, how.down, 0.0]) + middles[1] - turn @ middles[0]
    shift[2] = float(np.median([_contact_z(t.target) + t.target_shift_mm - _contact_z(t.source) - t.source_shift_mm
                                for t in touches]))  # fmt: skip
    target_from_source = np.eye(4)
    target_from_source[:3, :3], target_from_source[:3, 3] = turn, shift
    onward = target_from_source @ rigid.invert(described.alignment_from_source)
    return Alignment(alignment_from_source=described.alignment_from_source, target_from_alignment=freeze(onward))


def _middle_mm(depth: DepthMap) -> Doubles:
    """Return the image centre's offset (mm) from the optical axis, (3,) with z = 0."""
    camera = depth.camera
    off_px = np.array([(camera.cols - 1) / 2 - camera.cx_px, (camera.rows - 1) / 2 - camera.cy_px, 0.0])
    return off_px * compute_pixel_mm(depth)


def _contact_z(depth: DepthMap) -> float:
    return float(np.nanmedian(depth.depth_mm[depth.contact]))
