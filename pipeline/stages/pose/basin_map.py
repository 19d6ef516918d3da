"""The basin map of a felt touch: from where its registration ends in the answer that was given."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.geometry.meshes import Mesh
from pipeline.registration.basin_map import ShiftAxis, StartBasins, map_basins
from pipeline.stages.pose.signed_distances import PoseParams, prepare_search
from pipeline.values.results import DepthMap, ObjectPose

_ROTATION_STEP_DEG = 15.0
_N_TRANSLATIONS = 9
_REACH = 1.5  # times the contact's radius, either way


def compute_basin_map(
    touch_depth: DepthMap, mesh: Mesh | None, pose: ObjectPose, params: PoseParams, along: ShiftAxis = "x",
    progress: Progress = SILENT,
) -> StartBasins:  # fmt: skip
    """Starts all around the contact's normal and 1.5 of its radii to both sides of `pose`; raises SettingProblem."""
    if pose.sensor_from_object is None:
        raise SettingProblem(f"there is no pose to look around: {(pose.notes or ('none was found',))[0]}")
    ready = prepare_search(touch_depth, mesh, params, SubProgress(progress, 0.0, 0.1))
    if isinstance(ready, ObjectPose):
        raise SettingProblem(f"there is no pose to look around: {ready.notes[0]}")
    search, _ = ready
    reach = _REACH * search.points.radius_mm
    turns: Doubles = np.arange(-180.0, 180.0, _ROTATION_STEP_DEG)
    shifts: Doubles = np.linspace(-reach, reach, _N_TRANSLATIONS)
    return map_basins(search, pose.sensor_from_object, turns, shifts, along, SubProgress(progress, 0.1, 0.9))
