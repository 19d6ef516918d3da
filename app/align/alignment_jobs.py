"""Background jobs of the alignment: drag preview, assessment of a frame, refinement on all
frames.
"""

from dataclasses import replace
from typing import cast

from app.document.evaluator import Evaluator
from app.document.requests import get_depth_params, make_request
from app.session.state import Session
from app.window.jobs import JobReporter
from pipeline.core.arrays import Doubles
from pipeline.core.frozen import frozen
from pipeline.sensors.alignment import Offsets, decompose_motion
from pipeline.stages.target_depth.stage import POINT_SPLAT, SURFACE
from pipeline.stages.target_depth.surface_projection import ProjectionParams
from pipeline.translation.alignment.refine import Refinement, refine_on_recording
from pipeline.translation.alignment.score import AlignmentScore, Sensitivity
from pipeline.translation.translate import Translation, open_translation
from pipeline.translation.truth_view import TruthView
from pipeline.views.image_views import TARGET_DEPTH
from pipeline.views.layers import Layer
from pipeline.views.preview import Preview, add_observed_outline, enlarge_preview

VALIDATION_FRACTION = 0.25  # of the touches, held out to validate a refinement


@frozen
class DragPreview:
    """Coarse target depth and agreement while the alignment is dragged."""

    preview: Preview
    observation_view: TruthView | None  # the target's own touch, if recorded
    layers: tuple[Layer, ...]
    score: AlignmentScore | None


@frozen
class AlignmentAssessment:
    """Agreement of one frame, and the sensitivity of each axis once computed."""

    score: AlignmentScore | None
    sensitivities: tuple[Sensitivity, ...] = ()
    no_score_reason: str  # why `score` is None
    origin: str  # where the alignment without offsets comes from
    pivot_mm: Doubles  # (3,) target frame


@frozen
class RefinementProposal:
    """A refinement, and the offsets to set when it is accepted."""

    refinement: Refinement
    offsets: Offsets


@frozen
class BeforeAfter:
    """Previews of the target depth under the current and the refined alignment."""

    before: Preview
    after: Preview


def draw_before_and_after(
    evaluator: Evaluator, session: Session, proposed_offsets: Offsets, report: JobReporter
) -> BeforeAfter:
    """Draw the target depth under the session's and the proposed offsets, minus the target's own
    touch if known.
    """
    opened, frame = evaluator.compare_with_target(session, report)
    params = get_projection_params(session)
    context = opened.make_preview_context({}, session.display)

    def draw_preview(offsets: Offsets) -> Preview:
        depth, _ = frame.project_touch(offsets.apply_to(opened.alignment), params)
        preview = TARGET_DEPTH.make_preview(depth, context)
        view = frame.view_observation(preview, session.display)
        if view is not None:
            preview = view.difference_to_truth or preview
        # The outline of the prediction would lie over both sides of the wipe; the observed one fits
        # both.
        return replace(
            preview,
            outline_px=None,
            observed_outline_px=frame.observed_outline_px,
            caption="left: current; right: refined",
        )

    return BeforeAfter(before=draw_preview(session.offsets), after=draw_preview(proposed_offsets))


def preview_drag(evaluator: Evaluator, session: Session, report: JobReporter) -> DragPreview:
    """Draw the session's frame under its offsets, coarse; raises TouchError."""
    opened, frame = evaluator.compare_with_target(session, report)
    report.step(0.5, "previewing the alignment")
    alignment = session.offsets.apply_to(opened.alignment)
    params = get_projection_params(session)
    depth, _ = frame.project_touch(alignment, params, frame.preview_downsampling)
    score = frame.compute_score(alignment, params)
    context = opened.make_preview_context({}, session.display)
    small = TARGET_DEPTH.make_preview(depth, context)
    preview = enlarge_preview(small, opened.target.camera.shape)
    return DragPreview(
        preview=add_observed_outline(preview, frame.observed_outline_px),
        observation_view=frame.view_observation(preview, session.display),
        layers=TARGET_DEPTH.make_layers(depth, context, small),
        score=score,
    )


def assess_alignment(
    evaluator: Evaluator, session: Session, report: JobReporter
) -> AlignmentAssessment:
    """Assess the session's frame at full size.

    The score is delivered before the sensitivities. Raises TouchError.
    """
    opened, frame = evaluator.compare_with_target(session, report)
    alignment = session.offsets.apply_to(opened.alignment)
    params = get_projection_params(session)
    first = AlignmentAssessment(
        score=frame.compute_score(alignment, params),
        no_score_reason=frame.unavailable_reason,
        origin=_describe_origin(opened),
        pivot_mm=frame.compute_pivot_mm(opened.alignment),
    )
    report.deliver(first)
    pivot_mm = frame.compute_pivot_mm(alignment)
    found = frame.compute_sensitivities(alignment, params, pivot_mm, report)
    return replace(first, sensitivities=found)


def propose_refinement(session: Session, report: JobReporter) -> RefinementProposal:
    """Refine the session's alignment on all frames that both sensors recorded; raises TouchError.

    It opens the recording a second time. Every fourth touch is held out for validation if there are
    enough.
    """
    with open_translation(make_request(session)) as translation:
        refinement = refine_on_recording(
            translation,
            range(translation.n_frames),
            start=session.offsets.apply_to(translation.alignment),
            params=get_depth_params(session, translation.methods),
            hold_out=VALIDATION_FRACTION,
            progress=report,
        )
    pivot_mm = session.offsets.pivot_mm if any(session.offsets.pivot_mm) else refinement.pivot_mm
    return RefinementProposal(
        refinement=refinement,
        offsets=decompose_motion(refinement.motion @ session.offsets.to_matrix(), pivot_mm),
    )


def get_projection_params(session: Session) -> ProjectionParams:
    """Return the projection parameters of the session's target depth method."""
    is_splat = session.methods.get("target_depth") == POINT_SPLAT.name
    return cast("ProjectionParams", session.get_params(POINT_SPLAT if is_splat else SURFACE))


def _describe_origin(opened: Translation) -> str:
    if opened.request.alignment is not None:
        return opened.request.alignment.name
    other = opened.recording.find_partner(opened.stream.name, opened.target.name)
    if other and opened.recording.target_from_source(opened.stream.name, other.name) is not None:
        return "as recorded"
    return "as described by the sensors"
