"""Background work around an alignment: the preview of a drag, its figures when still, and refining on all frames."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace

from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import Report
from app.work.opening import depth_params, request_of
from pipeline.alignment.refine import Refinement, refine
from pipeline.alignment.score import Score
from pipeline.alignment.sensitivity import Sensitivity
from pipeline.alignment.touches import paired_touches
from pipeline.base.arrays import Doubles
from pipeline.base.errors import SettingProblem
from pipeline.pictures.layers import Layer
from pipeline.pictures.picture import Picture, beside, enlarged
from pipeline.scoring.beside import Beside, beside_felt
from pipeline.sensors.offsets import Offsets, of_motion
from pipeline.stages.project import slot as view_slot
from pipeline.stages.project.stage import Projection
from pipeline.stages.slot import Seen
from pipeline.translation.translate import Translation, open_translation

HELD_OUT = 0.25  # of the touches judge a refinement without having taken part in it


@dataclass(frozen=True, slots=True, kw_only=True)
class Previewed:
    """A drag on its way: what the target would see, coarse."""

    picture: Picture
    beside: Beside | None  # what the target felt itself, where it took part
    layers: tuple[Layer, ...]
    score: Score | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A frame at rest: how well it agrees, and which axis matters once that is known."""

    index: int
    score: Score | None
    axes: tuple[Sensitivity, ...]
    reason: str  # why there is no score
    origin: str  # whose alignment it is without offsets, in words
    pivot_mm: Doubles  # (3,) target frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Refined:
    """A refinement, and the offsets from the opened alignment that accept it."""

    answer: Refinement
    offsets: Offsets
    begun: Session


@dataclass(frozen=True, slots=True, kw_only=True)
class BeforeAfter:
    """The target's view of a frame as it is aligned, and as a refinement would have it, drawn alike."""

    before: Picture
    after: Picture


def before_and_after(evaluator: Evaluator, session: Session, refined_to: Offsets, report: Report) -> BeforeAfter:
    """The session's frame under its offsets and under others: less what the target felt, where that is known."""
    opened, frame = evaluator.comparison(session, report)
    params = project_params(session)
    seen = Seen(outputs={}, source=opened.source, target=opened.target, mesh=None, display=session.display)

    def drawn(offsets: Offsets) -> Picture:
        picture = view_slot.picture(frame.view(offsets.applied(opened.alignment), params), seen)
        if frame.touch is not None:
            gap = beside_felt(picture, frame.touch.target, opened.target, session.display).gap
            picture = picture if gap is None else gap
        # One outline would lie over both sides of the handle; what was felt is the same on either.
        return replace(picture, outline_px=None, felt_px=frame.outline_px, caption="left: as it is; right: as refined")

    return BeforeAfter(before=drawn(session.offsets), after=drawn(refined_to))


def preview(evaluator: Evaluator, session: Session, report: Report) -> Previewed:
    """The session's frame under its offsets, coarse; raises TouchError."""
    opened, frame = evaluator.comparison(session, report)
    report.step(0.5, "previewing the alignment")
    view, agreement = frame.preview(session.offsets.applied(opened.alignment), project_params(session))
    seen = Seen(outputs={}, source=opened.source, target=opened.target, mesh=None, display=session.display)
    picture = view_slot.picture(view, seen)
    whole = enlarged(picture, opened.target.camera.shape)
    own = None if frame.touch is None else beside_felt(whole, frame.touch.target, opened.target, session.display)
    return Previewed(
        picture=beside(whole, frame.outline_px), beside=own, layers=view_slot.layers(view, seen, picture),
        score=agreement,
    )  # fmt: skip


def judge(evaluator: Evaluator, session: Session, report: Report) -> Judged:
    """The session's frame judged at full size; the score is handed over ahead of the axes. Raises TouchError."""
    opened, frame = evaluator.comparison(session, report)
    alignment, params = session.offsets.applied(opened.alignment), project_params(session)
    first = Judged(
        index=frame.index, score=frame.scored(alignment, params), axes=(), reason=frame.reason,
        origin=_origin(opened), pivot_mm=frame.pivot_mm(opened.alignment),
    )  # fmt: skip
    report.hand_over(first)
    return replace(first, axes=frame.axes(alignment, params, frame.pivot_mm(alignment), report))


def refined(session: Session, report: Report) -> Refined:
    """The session's alignment refined on all frames that both sensors feel, with a recording of its own.

    Every fourth touch is held out where there are enough. Raises TouchError.
    """
    from pipeline.cli.align import split

    with closing(open_translation(request_of(session))) as translation:
        frames = range(translation.n_frames)
        touches = paired_touches(translation, frames, depth_params(session), progress=report)
        if not touches:
            pair = f"{translation.source.name} and {translation.target.name}"
            raise SettingProblem(f"no frame is felt by both {pair}; an alignment is refined on touches of both sensors")
        used, held = split(touches, HELD_OUT)
        begun = session.offsets.applied(translation.alignment)
        answer = refine(used, begun, held_out=held, progress=report)
    about = session.offsets.pivot_mm if any(session.offsets.pivot_mm) else answer.pivot_mm
    return Refined(answer=answer, offsets=of_motion(answer.motion @ session.offsets.motion(), about), begun=session)


def project_params(session: Session) -> Projection:
    """How the projection is drawn, by the method that fills the view."""
    paper = session.methods.get("view") == view_slot.PAPER.name
    params = session.params_of(view_slot.PAPER if paper else view_slot.SURFACE)
    assert isinstance(params, Projection)
    return params


def _origin(opened: Translation) -> str:
    if opened.request.alignment is not None:
        return opened.request.alignment.name
    other = opened.recording.stream_of_sensor(opened.target.name)
    known = None if other is None else opened.recording.target_from_source(opened.stream.name, other.name)
    return "as described by the sensors" if known is None else "as recorded"
