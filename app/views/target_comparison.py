"""One frame as both sensors recorded it: the transferred touch and the target's own, for judging
the alignment.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from pipeline.core.arrays import Doubles, Floats
from pipeline.core.errors import TouchError
from pipeline.core.progress import Progress
from pipeline.core.values.results import DepthMap, TargetDepth
from pipeline.sensors.alignment import Alignment, shift_alignment_along_z
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.target_depth.surface_projection import ProjectionParams, project_cloud
from pipeline.translation.alignment.nudge import compute_pivot_mm
from pipeline.translation.alignment.score import (
    AlignmentScore,
    Sensitivity,
    TargetObservation,
    choose_preview_factor,
    compute_sensitivities,
    observe_target,
    score_preview,
)
from pipeline.translation.alignment.touches import AlignmentTouch
from pipeline.translation.translate import Translation, estimate_camera_shift_mm
from pipeline.translation.truth_view import TruthView, build_observation_view
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview, trace_outline


@dataclass(frozen=True, kw_only=True)  # cached properties need __dict__
class TargetComparison:
    """One frame of both sensors.

    Without `paired_touch`, `unavailable_reason` says why there is none.
    """

    target: SensorSpec
    source: DepthMap
    source_shift_mm: float
    paired_touch: AlignmentTouch | None
    unavailable_reason: str

    def compute_pivot_mm(self, opened: Alignment) -> Doubles:
        """Centre of contact (3,) mm in the target frame under the opened alignment: the pivot of
        rotations.
        """
        return compute_pivot_mm(self.source, self._shift(opened))

    def _shift(self, alignment: Alignment) -> Alignment:
        """Return the alignment of the source where this frame has it."""
        return shift_alignment_along_z(
            alignment, source_shift_mm=self.source_shift_mm, target_shift_mm=0.0
        )

    @cached_property
    def preview_downsampling(self) -> int:
        """Target pixels per preview pixel along each side."""
        return choose_preview_factor(self.target)

    @cached_property
    def _observations(self) -> Mapping[int, TargetObservation]:
        """The target's own touch by downsampling factor; {} without a paired touch."""
        if self.paired_touch is None:
            return {}
        touch = self.paired_touch.target
        return {
            n: observe_target(touch, self.target, factor=n) for n in (1, self.preview_downsampling)
        }

    @cached_property
    def observed_outline_px(self) -> Floats | None:
        """Contact border (n, 2) x, y in pixels of the target's own touch."""
        return (
            None if self.paired_touch is None else trace_outline(self.paired_touch.target.contact)
        )

    def view_observation(self, preview: Preview, display: DisplayParams) -> TruthView | None:
        """View the target's own touch beside a preview of the target depth, if it is recorded."""
        if self.paired_touch is None:
            return None
        return build_observation_view(preview, self.paired_touch.target, self.target, display)

    def project_touch(
        self, alignment: Alignment, params: ProjectionParams, downsampling: int = 1
    ) -> tuple[TargetDepth, AlignmentScore | None]:
        """Project the touch into the target at full or preview resolution, and score it against
        a paired touch.
        """
        if self.paired_touch is not None:
            return score_preview(
                self.paired_touch, alignment, self._observations[downsampling], params
            )
        target = self.target.with_camera(self.target.camera.scale(1.0 / downsampling))
        every = BackProjectionParams(stride=min(2, downsampling))
        cloud = back_project_depth(self.source, self._shift(alignment), every)
        return project_cloud(cloud, target, params), None

    def compute_score(
        self, alignment: Alignment, params: ProjectionParams
    ) -> AlignmentScore | None:
        """Score the agreement at full resolution; None without a paired touch."""
        return None if self.paired_touch is None else self.project_touch(alignment, params)[1]

    def compute_sensitivities(
        self, alignment: Alignment, params: ProjectionParams, pivot: Doubles, progress: Progress
    ) -> tuple[Sensitivity, ...]:
        """Compute the sensitivity of each axis; () without a paired touch."""
        if self.paired_touch is None:
            return ()
        coarse = self._observations[self.preview_downsampling]
        return compute_sensitivities(
            self.paired_touch, alignment, coarse, params, pivot=pivot, progress=progress
        )


def build_target_comparison(
    translation: Translation, index: int, params: DepthParams, source: DepthMap
) -> TargetComparison:
    """Compare frame `index` of both sensors.

    `source` is its depth, the target's is computed here.
    """
    frame = translation.stream.frame(index)
    shift_mm = estimate_camera_shift_mm(frame, translation.source)
    try:
        touch, reason = _pair_touches(translation, index, source, shift_mm, params)
    except TouchError as error:
        touch = None
        reason = f"the recorded {translation.target.title} touch cannot be used: {error}"
    return TargetComparison(
        target=translation.target,
        source=source,
        source_shift_mm=shift_mm,
        paired_touch=touch,
        unavailable_reason=reason,
    )


def _pair_touches(
    translation: Translation, index: int, source: DepthMap, shift_mm: float, params: DepthParams
) -> tuple[AlignmentTouch | None, str]:
    spec = translation.target
    other = translation.read_target_observation(index)
    if other is None:
        return None, f"the recording has no {spec.title} touch to compare with"
    frame = other[0]
    depth = estimate_depth(frame, spec, None, params)
    touch = AlignmentTouch(
        index=index,
        source=source,
        target=depth,
        source_shift_mm=shift_mm,
        target_shift_mm=estimate_camera_shift_mm(frame, spec),
    )
    if not touch.has_contact_on_both:
        return None, f"frame {index} has no contact on both sensors"
    return touch, ""
