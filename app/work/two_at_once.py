"""Two sessions on one frame: each slot of one beside that of the other, and what the one is less the other."""

from __future__ import annotations

from dataclasses import dataclass

from app.session.state import Session
from app.work.drawing import SlotShown, SourceShown
from app.work.evaluator import Evaluator, FrameShown
from app.work.jobs import Gathered, Report
from app.work.side_by_side import Tiles
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.pictures.difference import difference
from pipeline.pictures.layers import Layer
from pipeline.pictures.picture import Picture
from pipeline.translation.translate import Translation
from widgets.tiles import Tile

SOURCE, _WORKING = "source", "working…"


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One of the two, worked out; without `shown` there is only `problem`."""

    letter: str
    shown: FrameShown | None
    parts: dict[str, SourceShown | SlotShown]
    titles: dict[str, str]
    translation: Translation | None
    problem: str = ""

    def tile(self, slot: str, *, apart: bool = False) -> Tile:
        """A slot's picture with its figures."""
        part, title = self.parts.get(slot), f"{self.letter} · {self.titles.get(slot, slot)}"
        if part is None:
            return Tile(title=title, problem=self.problem or "this route does not have it", apart=apart)
        beside = part.beside if isinstance(part, SlotShown) else None
        doubts = part.result.doubts if isinstance(part, SlotShown) else ()
        return Tile(
            title=title, told=" · ".join([*self._figures(slot), *doubts]), picture=part.picture,
            truth=None if beside is None else beside.truth, gap=None if beside is None else beside.gap,
            problem=part.result.instead if isinstance(part, SlotShown) else "", apart=apart,
        )  # fmt: skip

    def figures(self, slot: str) -> dict[str, float]:
        """What is known of a slot's error."""
        metrics = {} if self.shown is None else self.shown.metrics
        return {name.partition(".")[2]: value for name, value in metrics.items() if name.startswith(f"{slot}.")}

    def _figures(self, slot: str) -> list[str]:
        return [f"{name} {value:.3g}" for name, value in self.figures(slot).items()]

    def picture(self, slot: str) -> Picture | None:
        """What is shown of a slot."""
        part = self.parts.get(slot)
        return None if part is None else part.picture

    def layers(self, slot: str) -> tuple[Layer, ...]:
        """The same in 3D."""
        part = self.parts.get(slot)
        return () if part is None else part.layers


def two_at_once(
    evaluators: tuple[Evaluator, Evaluator], sessions: tuple[Session, Session], slot: str, differs: str, report: Report
) -> Tiles:
    """A slot of both sessions, or all slots for "", on the first one's frame; raises TouchError of the first.

    What is wrong with the second stands in its place. Handed over as soon as the first is there.
    """
    one = _side("A", evaluators[0], sessions[0], slot, report)
    waiting = Side(letter="B", shown=None, parts={}, titles=one.titles, translation=None, problem=_WORKING)
    report.hand_over(_tiles(one, waiting, slot, differs))
    try:
        other = _side("B", evaluators[1], sessions[1], slot, report)
    except TouchError as error:
        other = Side(letter="B", shown=None, parts={}, titles=one.titles, translation=None, problem=str(error))
    return _tiles(one, other, slot, differs)


def _side(letter: str, evaluator: Evaluator, session: Session, slot: str, report: Report) -> Side:
    translation, index = evaluator.at(session, Gathered(report))
    if index != session.frame:
        raise SettingProblem(f"no frame {session.frame}; this recording has frames 0 to {translation.n_frames - 1}")
    wanted = translation.slots if not slot else tuple(name for name in translation.slots if name == slot)
    gathered = Gathered(report)
    shown = evaluator.show(session, wanted, gathered, with_truth=True)
    parts: dict[str, SourceShown | SlotShown] = {}
    for part in gathered.parts:
        if isinstance(part, SourceShown):
            parts[SOURCE] = part
        elif isinstance(part, SlotShown):
            parts[part.result.name] = part
    return Side(letter=letter, shown=shown, parts=parts, titles=_titles(translation), translation=translation)


def _titles(translation: Translation) -> dict[str, str]:
    return {SOURCE: "Source", **{name: translation.catalogue.slot(name).title for name in translation.slots}}


def _tiles(one: Side, other: Side, slot: str, differs: str) -> Tiles:
    told = f"A (now) and B (held) on frame {one.shown.index}: {differs}" if one.shown is not None else differs
    if other.problem not in ("", _WORKING):
        told = f"{told} · B: {other.problem}"
    if not slot:
        names = list(dict.fromkeys((*one.parts, *other.parts)))
        rows = [side.tile(name, apart=name == names[0]) for side in (one, other) for name in names]
        return Tiles(tiles=tuple(rows), told=told)
    return Tiles(
        tiles=(one.tile(slot), other.tile(slot), _less(one, other, slot)), told=told,
        slot=slot, solids=tuple((side.layers(slot), side.translation) for side in (one, other)),
    )  # fmt: skip


def _less(one: Side, other: Side, slot: str) -> Tile:
    """The first less the second; a wipe and blinking are between the two."""
    a, b = one.picture(slot), other.picture(slot)
    ours, theirs = one.figures(slot), other.figures(slot)
    told = " · ".join(f"{name} {ours[name] - theirs[name]:+.3g}" for name in ours if name in theirs)
    gap = None if a is None or b is None else difference(a, b, words="A less B")
    if gap is None:
        why = "" if b is None else "these two cannot be subtracted: they have other pixels, or no common scale"
        return Tile(title="A less B", told=told, problem=why)
    return Tile(title="A less B", told=told, picture=a, truth=b, gap=gap, usual="difference")
