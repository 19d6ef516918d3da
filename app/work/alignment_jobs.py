"""Background work around an alignment: the preview of a drag, its figures when still, and refining on all frames."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace

from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from app.work.requests import get_depth_params, make_request
from pipeline.alignment.refine import Refinement, refine_alignment
from pipeline.alignment.score import AlignmentScore
from pipeline.alignment.sensitivity import Sensitivity
from pipeline.alignment.touches import load_paired_touches
from pipeline.base.arrays import Doubles
from pipeline.base.errors import SettingProblem
from pipeline.evaluation.truth_view import TruthView, build_observation_view
from pipeline.previews.layers import Layer
from pipeline.previews.preview import Preview, add_observed_outline, enlarge_preview
from pipeline.sensors.offsets import Offsets, decompose_motion
from pipeline.stages.stage import PreviewContext
from pipeline.stages.target_depth import stage as view_slot
from pipeline.stages.target_depth.surface_projection import ProjectionParams
from pipeline.translation.translate import Translation, open_translation

VALIDATION_FRACTION = 0.25  # of the touches judge a refinement without having taken part in it


@dataclass(frozen=True, slots=True, kw_only=True)
class DragPreview:
    """A drag on its way: what the target would see, coarse."""

    preview: Preview
    observation_view: TruthView | None  # what the target felt itself, where it took part
    layers: tuple[Layer, ...]
    score: AlignmentScore | None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentAssessment:
    """A frame at rest: how well it agrees, and which axis matters once that is known."""

    index: int
    score: AlignmentScore | None
    sensitivities: tuple[Sensitivity, ...]
    no_score_reason: str  # why there is no score
    origin: str  # whose alignment it is without offsets, in words
    pivot_mm: Doubles  # (3,) target frame


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementProposal:
    """A refinement, and the offsets from the opened alignment that accept it."""

    refinement: Refinement
    offsets: Offsets
    base_session: Session


@dataclass(frozen=True, slots=True, kw_only=True)
class BeforeAfter:
    """The target's view of a frame as it is aligned, and as a refinement would have it, drawn alike."""

    before: Preview
    after: Preview


def draw_before_and_after(
    evaluator: Evaluator, session: Session, refined_to: Offsets, report: JobReporter
) -> BeforeAfter:
    """The session's frame under its offsets and under others: less what the target felt, where that is known."""
    opened, frame = evaluator.compare_with_target(session, report)
    params = get_projection_params(session)
    seen = PreviewContext(outputs={}, source=opened.source, target=opened.target, mesh=None, display=session.display)

    def draw_preview(offsets: Offsets) -> Preview:
        picture = view_slot.make_preview(frame.project_touch(offsets.apply_to(opened.alignment), params), seen)
        if frame.paired_touch is not None:
            gap = build_observation_view(
                picture, frame.paired_touch.target, opened.target, session.display
            ).difference_to_truth
            picture = picture if gap is None else gap
        # One outline would lie over both sides of the handle; what was felt is the same on either.
        return replace(
            picture,
            outline_px=None,
            observed_outline_px=frame.observed_outline_px,
            caption="left: as it is; right: as refined",
        )

    return BeforeAfter(before=draw_preview(session.offsets), after=draw_preview(refined_to))


def preview_drag(evaluator: Evaluator, session: Session, report: JobReporter) -> DragPreview:
    """The session's frame under its offsets, coarse; raises TouchError."""
    opened, frame = evaluator.compare_with_target(session, report)
    report.step(0.5, "previewing the alignment")
    view, agreement = frame.preview_alignment(
        session.offsets.apply_to(opened.alignment), get_projection_params(session)
    )
    seen = PreviewContext(outputs={}, source=opened.source, target=opened.target, mesh=None, display=session.display)
    picture = view_slot.make_preview(view, seen)
    whole = enlarge_preview(picture, opened.target.camera.shape)
    own = (
        None
        if frame.paired_touch is None
        else build_observation_view(whole, frame.paired_touch.target, opened.target, session.display)
    )
    return DragPreview(
        preview=add_observed_outline(whole, frame.observed_outline_px),
        observation_view=own,
        layers=view_slot.make_layers(view, seen, picture),
        score=agreement,
    )


def assess_alignment(evaluator: Evaluator, session: Session, report: JobReporter) -> AlignmentAssessment:
    """The session's frame judged at full size; the score is handed over ahead of the axes. Raises TouchError."""
    opened, frame = evaluator.compare_with_target(session, report)
    alignment, params = session.offsets.apply_to(opened.alignment), get_projection_params(session)
    first = AlignmentAssessment(
        index=frame.index,
        score=frame.compute_score(alignment, params),
        sensitivities=(),
        no_score_reason=frame.unavailable_reason,
        origin=_origin(opened),
        pivot_mm=frame.compute_pivot_mm(opened.alignment),
    )
    report.deliver(first)
    return replace(
        first, sensitivities=frame.compute_sensitivities(alignment, params, frame.compute_pivot_mm(alignment), report)
    )


def propose_refinement(session: Session, report: JobReporter) -> RefinementProposal:
    """The session's alignment refined on all frames that both sensors feel, with a recording of its own.

    Every fourth touch is held out where there are enough. Raises TouchError.
    """
    from pipeline.cli.align import split_held_out

    with closing(open_translation(make_request(session))) as translation:
        frames = range(translation.n_frames)
        touches = load_paired_touches(translation, frames, get_depth_params(session), progress=report)
        if not touches:
            pair = f"{translation.source.name} and {translation.target.name}"
            raise SettingProblem(f"no frame is felt by both {pair}; an alignment is refined on touches of both sensors")
        used, held = split_held_out(touches, VALIDATION_FRACTION)
        begun = session.offsets.apply_to(translation.alignment)
        answer = refine_alignment(used, begun, held_out=held, progress=report)
    about = session.offsets.pivot_mm if any(session.offsets.pivot_mm) else answer.pivot_mm
    return RefinementProposal(
        refinement=answer,
        offsets=decompose_motion(answer.motion @ session.offsets.to_matrix(), about),
        base_session=session,
    )


def get_projection_params(session: Session) -> ProjectionParams:
    """How the projection is drawn, by the method that fills the view."""
    paper = session.methods.get("target_depth") == view_slot.POINT_SPLAT.name
    params = session.get_params(view_slot.POINT_SPLAT if paper else view_slot.SURFACE)
    assert isinstance(params, ProjectionParams)
    return params


def _origin(opened: Translation) -> str:
    if opened.request.alignment is not None:
        return opened.request.alignment.name
    other = opened.recording.stream_of_sensor(opened.target.name)
    known = None if other is None else opened.recording.target_from_source(opened.stream.name, other.name)
    return "as described by the sensors" if known is None else "as recorded"
