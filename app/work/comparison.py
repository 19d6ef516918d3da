"""What the target really felt beside what the alignment carries over: of one frame, worked out once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from pipeline.alignment.felt import Felt, felt, preview_factor
from pipeline.alignment.nudge import pivot_mm
from pipeline.alignment.score import Score, preview
from pipeline.alignment.sensitivity import Sensitivity, sensitivities
from pipeline.alignment.touches import PairedTouch
from pipeline.base.arrays import Doubles, Floats
from pipeline.base.errors import TouchError
from pipeline.base.progress import Progress
from pipeline.pictures.picture import outline
from pipeline.sensors.alignment import Alignment, placed
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.adapt.stage import AdaptParams, adapt
from pipeline.stages.depth.stage import DepthParams, depth, untouched
from pipeline.stages.project.stage import Projection, project
from pipeline.translation.translate import Translation, own_shift_mm
from pipeline.values.results import DepthMap, TargetView


@dataclass(frozen=True, kw_only=True)  # no slots: what is asked for is worked out once and kept
class Comparison:
    """One frame as both sensors felt it; without `touch` there is nothing to compare with, and `reason` says why."""

    index: int
    target: SensorSpec
    source: DepthMap
    source_shift_mm: float
    touch: PairedTouch | None
    reason: str

    def pivot_mm(self, opened: Alignment) -> Doubles:
        """The middle of the contact (3,) in the target frame under the opened alignment: what turns are about."""
        return pivot_mm(self.source, placed(opened, source_shift_mm=self.source_shift_mm, target_shift_mm=0.0))

    @cached_property
    def factor(self) -> int:
        """One preview pixel is this many of the target's along each side."""
        return preview_factor(self.target)

    @cached_property
    def coarse(self) -> Felt | None:
        """The target's side for dragging."""
        return None if self.touch is None else felt(self.touch.target, self.target, factor=self.factor)

    @cached_property
    def full(self) -> Felt | None:
        """The target's side at full size."""
        return None if self.touch is None else felt(self.touch.target, self.target)

    @cached_property
    def outline_px(self) -> Floats | None:
        """Border (n, 2) of what the target felt, on its full image."""
        return None if self.touch is None else outline(self.touch.target.contact)

    def preview(self, alignment: Alignment, params: Projection) -> tuple[TargetView, Score | None]:
        """The touch as the alignment carries it over, drawn coarse, and how well it agrees: the figures of a rest."""
        if self.touch is not None and self.coarse is not None:
            return preview(self.touch, alignment, self.coarse, params)[0], self.scored(alignment, params)
        there = placed(alignment, source_shift_mm=self.source_shift_mm, target_shift_mm=0.0)
        small = self.target.seen_through(self.target.camera.scaled(1.0 / self.factor))
        return project(adapt(self.source, there, AdaptParams(stride=min(2, self.factor))), small, params), None

    def view(self, alignment: Alignment, params: Projection) -> TargetView:
        """The touch as the alignment carries it over, at full size."""
        if self.touch is not None and self.full is not None:
            return preview(self.touch, alignment, self.full, params)[0]
        there = placed(alignment, source_shift_mm=self.source_shift_mm, target_shift_mm=0.0)
        return project(adapt(self.source, there, AdaptParams()), self.target, params)

    def scored(self, alignment: Alignment, params: Projection) -> Score | None:
        """How well the touch agrees at full size."""
        return None if self.touch is None or self.full is None else preview(self.touch, alignment, self.full, params)[1]

    def axes(
        self, alignment: Alignment, params: Projection, pivot: Doubles, progress: Progress
    ) -> tuple[Sensitivity, ...]:
        """Which axis matters; nothing where there is nothing to compare with."""
        if self.touch is None or self.coarse is None:
            return ()
        return sensitivities(self.touch, alignment, self.coarse, params, pivot=pivot, progress=progress)


def comparison_of(translation: Translation, index: int, params: DepthParams, source: DepthMap) -> Comparison:
    """Frame `index` on both sides, `source` being its depth; the target's is worked out here."""
    frame = translation.stream.frame(index)
    shift_mm = own_shift_mm(frame, translation.source)
    touch, reason = None, ""
    try:
        touch, reason = _paired(translation, index, source, shift_mm, params)
    except TouchError as error:
        reason = f"{translation.target.name}'s own touch cannot be used: {error}"
    return Comparison(
        index=index, target=translation.target, source=source, source_shift_mm=shift_mm, touch=touch, reason=reason
    )


def _paired(
    translation: Translation, index: int, source: DepthMap, shift_mm: float, params: DepthParams
) -> tuple[PairedTouch | None, str]:
    spec, other = translation.target, translation.truth_of_target(index)
    if other is None:
        return None, f"the recording has no {spec.name} touch to compare with"
    seen = other[0]
    felt_there = untouched(seen, spec, None, params) or depth(seen, spec, None, params)
    touch = PairedTouch(
        index=index, source=source, target=felt_there, source_shift_mm=shift_mm,
        target_shift_mm=own_shift_mm(seen, spec),
    )  # fmt: skip
    if not touch.felt_by_both:
        return None, f"frame {index} is not felt by both sensors"
    return touch, ""
