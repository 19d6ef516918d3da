"""Two sessions on one frame, each by an evaluator of its own."""

from __future__ import annotations

from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.evaluation.comparison_tiles import ComparisonTiles
from pipeline.evaluation.variant_comparison import IN_PROGRESS, Variant, build_tiles, evaluate_variant


def compare_variants(
    evaluators: tuple[Evaluator, Evaluator],
    sessions: tuple[Session, Session],
    stage: str,
    differs: str,
    report: JobReporter,
) -> ComparisonTiles:
    """A slot of both sessions, or all slots for "", on the first one's frame; raises TouchError of the first.

    What is wrong with the second stands in its place. Handed over as soon as the first is there.
    """
    one = _side("A", evaluators[0], sessions[0], stage, report)
    waiting = Variant(label="B", titles=one.titles, problem=IN_PROGRESS)
    report.deliver(build_tiles(one, waiting, stage, differs))
    try:
        other = _side("B", evaluators[1], sessions[1], stage, report)
    except TouchError as error:
        other = Variant(label="B", titles=one.titles, problem=str(error))
    return build_tiles(one, other, stage, differs)


def _side(letter: str, evaluator: Evaluator, session: Session, stage: str, report: JobReporter) -> Variant:
    translation, index = evaluator.open_frame(session, report)
    if index != session.frame:
        raise SettingProblem(f"no frame {session.frame}; this recording has frames 0 to {translation.n_frames - 1}")
    graph = translation.build_graph(like=evaluator.graph)
    return evaluate_variant(letter, translation, index, session.params, session.display, stage, graph, report)
