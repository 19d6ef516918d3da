"""Two sessions on one frame, each by an evaluator of its own."""

from __future__ import annotations

from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import Report
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.scoring.tiles import Tiles
from pipeline.scoring.two_at_once import WORKING, Side, side_of, tiles_of


def two_at_once(
    evaluators: tuple[Evaluator, Evaluator], sessions: tuple[Session, Session], slot: str, differs: str, report: Report
) -> Tiles:
    """A slot of both sessions, or all slots for "", on the first one's frame; raises TouchError of the first.

    What is wrong with the second stands in its place. Handed over as soon as the first is there.
    """
    one = _side("A", evaluators[0], sessions[0], slot, report)
    waiting = Side(letter="B", titles=one.titles, problem=WORKING)
    report.hand_over(tiles_of(one, waiting, slot, differs))
    try:
        other = _side("B", evaluators[1], sessions[1], slot, report)
    except TouchError as error:
        other = Side(letter="B", titles=one.titles, problem=str(error))
    return tiles_of(one, other, slot, differs)


def _side(letter: str, evaluator: Evaluator, session: Session, slot: str, report: Report) -> Side:
    translation, index = evaluator.at(session, report)
    if index != session.frame:
        raise SettingProblem(f"no frame {session.frame}; this recording has frames 0 to {translation.n_frames - 1}")
    graph = translation.graph(like=evaluator.graph)
    return side_of(letter, translation, index, session.params, session.display, slot, graph, report)
