"""Background job of the basin map: registration of one frame from a grid of start poses."""

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
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap, ObjectPose


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinMapResult:
    """A basin map with the frame it belongs to."""

    basins: StartBasins
    frame: int
    translation: Translation
    results: Mapping[str, StageResult]
    display: DisplayParams

    def make_preview(self, row: int, col: int) -> Preview:
        """Draw the pose that a start converged to; raises SettingProblem if it diverged."""
        if self.basins.minimum_index[row, col] == NO_MINIMUM:
            raise SettingProblem("this start did not converge")
        pose: ObjectPose = self.results["pose"].output
        answer = self.basins.minima[int(self.basins.minimum_index[row, col])]
        end_pose = replace(
            pose, sensor_from_object=self.basins.poses[row, col], fitness=answer.fitness,
            rmse_mm=float(self.basins.rmse_mm[row, col]),
        )  # fmt: skip
        outputs = {name: result.output for name, result in self.results.items()}
        context = self.translation.make_preview_context(outputs, self.display)
        return self.translation.catalogue.views["pose"].make_preview(end_pose, context)


def run_basin_map(
    translation: Translation, frame: int, results: Mapping[str, StageResult], display: DisplayParams,
    params: PoseParams, along: ShiftAxis, report: JobReporter,
) -> BasinMapResult:  # fmt: skip
    """Compute the basin map around a frame's pose; raises SettingProblem without a pose."""
    if "touch_depth" not in results or "pose" not in results:
        raise SettingProblem("this layout does not compute the object pose; choose one that shows it")
    depth, pose = results["touch_depth"].output, results["pose"].output
    assert isinstance(depth, DepthMap)
    assert isinstance(pose, ObjectPose)
    basins = compute_basin_map(depth, translation.mesh, pose, params, along, report)
    return BasinMapResult(basins=basins, frame=frame, translation=translation, results=results, display=display)
