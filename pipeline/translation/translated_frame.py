"""One frame of a translation as a script sees it: nothing is computed until it is asked for."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult, StageResults
from pipeline.translation.truth_view import add_truth_warnings

if TYPE_CHECKING:
    from pipeline.core.arrays import Floats, Image
    from pipeline.core.values.frames import TactileFrame
    from pipeline.core.values.results import (
        Cloud,
        DepthMap,
        GeneratedTouch,
        ObjectPose,
        TargetDepth,
    )
    from pipeline.stages.stage import GroundTruth
    from pipeline.translation.translate import Translation
    from pipeline.views.preview import Preview

_SHOWN_WIDTH_PX = 160  # of a stage's image in a notebook
_SIDE_BY_SIDE = "display: inline-block; margin: 4px"


class TranslatedFrame:
    """One touch of the source, and what each stage makes of it.

    `depth`, `cloud`, `target_depth`, `touch`, `touch_depth` and `pose` are the values of the
    stages; the first use of one computes it and what it depends on. All lengths are in mm, in the
    frame of the sensor that the stage names (x right, y down, z out along the optical axis). Arrays
    are read-only. A property raises `TouchError` where its stage cannot be computed, or is not on
    the route. In a notebook a frame shows its stages as images.
    """

    def __init__(self, translation: Translation, index: int) -> None:
        self.translation = translation
        self.index = index
        self._results: dict[str, StageResult] = {}

    def __repr__(self) -> str:
        there = ", ".join(self._results) or "nothing"
        names = f"{self.translation.source.name} -> {self.translation.target.name}"
        return f"<frame {self.index} of {names}; computed: {there}>"

    @property
    def source(self) -> TactileFrame:
        """The recorded frame: `image`, `reference`, `time_s`."""
        return self.translation.stream.frame(self.index)

    @property
    def image(self) -> Image | Floats:
        """The recorded image: (rows, cols, 3) uint8 RGB of a gel, or (rows, cols) float32 depth
        in mm of a bubble.
        """
        return self.source.image

    @property
    def depth(self) -> DepthMap:
        """The source's membrane, in the source's frame: `indentation_mm`, `depth_mm` and
        `contact` (rows, cols).
        """
        return self.result("depth").output

    @property
    def cloud(self) -> Cloud:
        """The contact as points in the target's frame: `points_mm` (n, 3)."""
        return self.result("cloud").output

    @property
    def target_depth(self) -> TargetDepth:
        """What the target's camera would see: `depth_mm`, `indentation_mm` and `contact` (rows,
        cols).
        """
        return self.result("target_depth").output

    @property
    def touch(self) -> GeneratedTouch:
        """The generated touch: `image` (rows, cols, 3) uint8 RGB of a gel, or (rows, cols)
        float32 mm of a bubble.
        """
        return self.result("touch").output

    @property
    def touch_depth(self) -> DepthMap:
        """The membrane of the generated touch, in the target's frame."""
        return self.result("touch_depth").output

    @property
    def pose(self) -> ObjectPose:
        """The object in the target's frame: `matrix` (4, 4) in mm, None where it cannot be
        estimated.
        """
        return self.result("pose").output

    @property
    def truth(self) -> GroundTruth:
        """What the recording knows exactly of this touch, and what the target's own sensor
        recorded of it.
        """
        return self.translation.read_ground_truth(self.index)

    @property
    def results(self) -> StageResults:
        """Stage -> result of every stage of the route: `output`, `state`, `ms`, `notes`,
        `answered_by`.
        """
        self._evaluate(self.translation.stages)
        return {name: self._results[name] for name in self.translation.stages}

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about this frame, each with its stage: warnings, fallbacks, and why a stage
        was skipped.
        """
        return tuple(
            f"{name}: {note}" for name, result in self.results.items() for note in result.notes
        )

    @property
    def metrics(self) -> Mapping[str, float]:
        """`stage.metric` -> error against the truth, in the unit that the name ends in.

        {} without any truth.
        """
        values = self.translation.compute_metrics(self.results, self.index)
        return {name: float(value) for name, value in values.items()}

    def result(self, stage: str) -> StageResult:
        """Return one stage's result with its time, state and notes.

        Raises SettingProblem for an unknown stage.
        """
        self._evaluate([stage])
        return self._results[stage]

    def preview(self, stage: str = "touch") -> Preview:
        """Return a stage as it is drawn: `pixels` (rows, cols, 3) uint8 RGB, `caption`, and the
        values behind them.
        """
        self._evaluate([stage])
        context = self.translation.make_preview_context(self._results)
        return self.translation.catalogue.views[stage].make_preview(context.outputs[stage], context)

    def _evaluate(self, stages: Iterable[str]) -> None:
        if not self._results.keys() >= set(stages):
            made = self.translation.evaluate(self.index, stages)
            if "target_depth" in made:  # the only stage whose truth adds a note
                made["target_depth"] = add_truth_warnings(made["target_depth"], self.truth)
            self._results |= made

    def _repr_html_(self) -> str:
        """Return the stages side by side, for a notebook."""
        import cv2

        cells: list[str] = []
        for name, result in self.results.items():
            preview = self.preview(name)
            png = base64.b64encode(
                cv2.imencode(".png", preview.pixels[..., ::-1])[1].tobytes()
            ).decode()
            caption = html.escape(f"{name} by {result.answered_by}")
            image = (
                f'<img src="data:image/png;base64,{png}" width="{_SHOWN_WIDTH_PX}" alt="{caption}">'
            )
            cells.append(
                f'<figure style="{_SIDE_BY_SIDE}">{image}'
                f"<figcaption>{caption}</figcaption></figure>"
            )
        return "".join(cells)


@frozen
class FrameReport:
    """Stages and metrics of one frame; `problem` is the reason if there are none."""

    index: int
    results: StageResults
    metrics: Mapping[str, float]
    problem: str = ""
    is_user_error: bool = True  # whether the user can mend the problem

    @property
    def without_arrays(self) -> FrameReport:
        """Return the report without arrays and functions, small enough to keep thousands of them
        and to send them between processes.
        """
        results = {
            name: replace(r, output=None, method=None, nodes=()) for name, r in self.results.items()
        }
        return replace(self, results=results, metrics=dict(self.metrics))
