"""Basin map of a touch: the starts from which the registration reaches the given pose."""

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
_MAX_TRANSLATION = 1.5  # times the contact's radius, in both directions


def compute_basin_map(
    touch_depth: DepthMap, mesh: Mesh | None, pose: ObjectPose, params: PoseParams, along: ShiftAxis = "x",
    progress: Progress = SILENT,
) -> StartBasins:  # fmt: skip
    """Map starts rotated about the contact's normal and translated by up to 1.5 contact radii around `pose`.

    Raises SettingProblem where there is no pose.
    """
    if pose.sensor_from_object is None:
        raise SettingProblem(f"there is no pose to map: {(pose.notes or ('none was found',))[0]}")
    prepared = prepare_search(touch_depth, mesh, params, SubProgress(progress, 0.0, 0.1))
    if isinstance(prepared, ObjectPose):
        raise SettingProblem(f"there is no pose to map: {prepared.notes[0]}")
    search, _ = prepared
    max_translation_mm = _MAX_TRANSLATION * search.points.radius_mm
    rotations_deg: Doubles = np.arange(-180.0, 180.0, _ROTATION_STEP_DEG)
    translations_mm: Doubles = np.linspace(-max_translation_mm, max_translation_mm, _N_TRANSLATIONS)
    return map_basins(
        search, pose.sensor_from_object, rotations_deg, translations_mm, along, SubProgress(progress, 0.1, 0.9)
    )
