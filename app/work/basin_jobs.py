"""The basin map of the touch on screen, and the picture of any pose in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from app.work.jobs import JobReporter
from pipeline.base.errors import SettingProblem
from pipeline.engine.graph import StageResult
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.preview import Preview
from pipeline.registration.basin_map import NO_MINIMUM, ShiftAxis, StartBasins
from pipeline.stages.pose.basin_map import compute_basin_map
from pipeline.stages.pose.signed_distances import PoseParams
from pipeline.stages.stage import PreviewContext
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap, ObjectPose


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinMapResult:
    """A map, and what it is of."""

    basins: StartBasins
    frame: int
    translation: Translation
    results: Mapping[str, StageResult]
    display: DisplayParams

    def make_preview(self, row: int, col: int) -> Preview:
        """The pose column's picture of where a start ended; raises SettingProblem for one that led nowhere."""
        if self.basins.minimum_index[row, col] == NO_MINIMUM:
            raise SettingProblem("that start led nowhere")
        pose: ObjectPose = self.results["pose"].output
        answer = self.basins.minima[int(self.basins.minimum_index[row, col])]
        there = replace(
            pose, sensor_from_object=self.basins.poses[row, col], fitness=answer.fitness,
            rmse_mm=float(self.basins.rmse_mm[row, col]),
        )  # fmt: skip
        seen = PreviewContext(
            outputs={name: result.output for name, result in self.results.items()}, source=self.translation.source,
            target=self.translation.target, mesh=self.translation.mesh, display=self.display,
        )  # fmt: skip
        return self.translation.catalogue.stage("pose").make_preview(there, seen)


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinPosePreview:
    """The picture of one start's end."""

    row: int
    col: int
    preview: Preview


def run_basin_map(
    translation: Translation, frame: int, results: Mapping[str, StageResult], display: DisplayParams,
    params: PoseParams, along: ShiftAxis, report: JobReporter,
) -> BasinMapResult:  # fmt: skip
    """The map around a frame's pose; raises SettingProblem where there is none."""
    if "touch_depth" not in results or "pose" not in results:
        raise SettingProblem("the object's pose is not worked out in this layout; choose one that shows it")
    felt, pose = results["touch_depth"].output, results["pose"].output
    assert isinstance(felt, DepthMap)
    assert isinstance(pose, ObjectPose)
    found = compute_basin_map(felt, translation.mesh, pose, params, along, report)
    return BasinMapResult(basins=found, frame=frame, translation=translation, results=results, display=display)
