"""The basin map of the touch on screen, and the picture of any pose in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from app.work.jobs import Report
from pipeline.base.errors import SettingProblem
from pipeline.engine.graph import StageResult
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.picture import Picture
from pipeline.registration.basins import NONE, Along, Basins
from pipeline.stages.pose.basins import basin_map
from pipeline.stages.pose.stage import PoseParams
from pipeline.stages.slot import Seen
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap, ObjectPose


@dataclass(frozen=True, slots=True, kw_only=True)
class Mapped:
    """A map, and what it is of."""

    basins: Basins
    frame: int
    translation: Translation
    results: Mapping[str, StageResult]
    display: DisplayParams

    def picture(self, row: int, col: int) -> Picture:
        """The pose column's picture of where a start ended; raises SettingProblem for one that led nowhere."""
        if self.basins.answer[row, col] == NONE:
            raise SettingProblem("that start led nowhere")
        pose: ObjectPose = self.results["pose"].output
        answer = self.basins.answers[int(self.basins.answer[row, col])]
        there = replace(
            pose, sensor_from_object=self.basins.poses[row, col], fitness=answer.fitness,
            rmse_mm=float(self.basins.rmse_mm[row, col]),
        )  # fmt: skip
        seen = Seen(
            outputs={name: result.output for name, result in self.results.items()}, source=self.translation.source,
            target=self.translation.target, mesh=self.translation.mesh, display=self.display,
        )  # fmt: skip
        return self.translation.catalogue.slot("pose").picture(there, seen)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pictured:
    """The picture of one start's end."""

    row: int
    col: int
    picture: Picture


def mapped(
    translation: Translation, frame: int, results: Mapping[str, StageResult], display: DisplayParams,
    params: PoseParams, along: Along, report: Report,
) -> Mapped:  # fmt: skip
    """The map around a frame's pose; raises SettingProblem where there is none."""
    if "felt" not in results or "pose" not in results:
        raise SettingProblem("the object's pose is not worked out in this layout; choose one that shows it")
    felt, pose = results["felt"].output, results["pose"].output
    assert isinstance(felt, DepthMap)
    assert isinstance(pose, ObjectPose)
    found = basin_map(felt, translation.mesh, pose, params, along, report)
    return Mapped(basins=found, frame=frame, translation=translation, results=results, display=display)
