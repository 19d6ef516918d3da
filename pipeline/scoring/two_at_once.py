"""Two translations on one frame: each slot of one beside that of the other, and what the one is less the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Graph, StageResult
from pipeline.pictures.difference import difference
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.layers import Layer, reading_layer
from pipeline.pictures.picture import Picture, fitted, of_reading
from pipeline.pictures.tiles import Tile
from pipeline.scoring.beside import Beside, beside
from pipeline.scoring.tiles import Tiles
from pipeline.stages.slot import Seen
from pipeline.translation.doubts import with_truth
from pipeline.translation.translate import Translation

SOURCE = "source"
WORKING = "working…"


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One slot of one of the two, drawn; without a result it is the reading itself."""

    picture: Picture
    layers: tuple[Layer, ...]
    result: StageResult | None = None
    beside: Beside | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One of the two, worked out; without parts there is only `problem`."""

    letter: str
    frame: int = -1
    parts: Mapping[str, Part] = field(default_factory=dict[str, Part])
    figures: Mapping[str, float] = field(default_factory=dict[str, float])  # slot.name -> value
    titles: Mapping[str, str] = field(default_factory=dict[str, str])
    translation: Translation | None = None
    problem: str = ""

    def tile(self, slot: str, *, apart: bool = False) -> Tile:
        """A slot's picture with its figures."""
        part, title = self.parts.get(slot), f"{self.letter} · {self.titles.get(slot, slot)}"
        if part is None:
            return Tile(title=title, problem=self.problem or "this route does not have it", apart=apart)
        figures, result, other = self.figures_of(slot), part.result, part.beside
        words = [f"{name} {value:.3g}" for name, value in figures.items()]
        return Tile(
            title=title, told=" · ".join([*words, *(() if result is None else result.doubts)]), figures=figures,
            picture=part.picture, truth=None if other is None else other.truth,
            gap=None if other is None else other.gap, problem="" if result is None else result.instead, apart=apart,
        )  # fmt: skip

    def figures_of(self, slot: str) -> dict[str, float]:
        """What is known of a slot's error."""
        return {name.partition(".")[2]: value for name, value in self.figures.items() if name.partition(".")[0] == slot}

    def picture(self, slot: str) -> Picture | None:
        """What is shown of a slot."""
        part = self.parts.get(slot)
        return None if part is None else part.picture

    def layers(self, slot: str) -> tuple[Layer, ...]:
        """The same in 3D."""
        part = self.parts.get(slot)
        return () if part is None else part.layers


def side_of(
    letter: str, translation: Translation, frame: int, given: Mapping[str, object], display: DisplayParams, slot: str,
    graph: Graph, progress: Progress = SILENT,
) -> Side:  # fmt: skip
    """A slot of a frame, or all slots for ""; `given` are parameters of methods by key. Raises TouchError."""
    source, facts = translation.source, translation.facts(translation.checked(frame))
    reading = translation.stream.frame(frame)
    camera = fitted(reading.camera or source.camera, reading.image.shape)
    picture = of_reading(reading.image, camera, source, display, reference=reading.reference)
    layer = reading_layer(SOURCE, reading.image, camera, picture.pixels, source)
    parts = {SOURCE: Part(picture=picture, layers=(layer,))}
    params = {m.slot: given.get(m.key, m.params()) for m in translation.methods}
    wanted = [name for name in translation.slots if slot in ("", name)]
    found = graph.evaluate(wanted, translation.inputs_of(reading), params, progress)
    results = {name: with_truth(result, facts) for name, result in found.items()}
    seen = Seen(
        outputs={name: result.output for name, result in results.items()}, source=source, target=translation.target,
        mesh=translation.mesh, display=display,
    )  # fmt: skip
    truths = translation.truths(frame)
    for name, result in results.items():
        entry = translation.catalogue.slot(name)
        made = entry.picture(result.output, seen)
        layers = entry.layers(result.output, seen, made)
        parts[name] = Part(picture=made, layers=layers, result=result, beside=beside(entry, made, truths, seen))
    titles = {SOURCE: "Source", **{name: translation.catalogue.slot(name).title for name in translation.slots}}
    figures = translation.figures(results, facts)
    return Side(
        letter=letter, frame=frame, parts=parts, figures=figures, titles=titles, translation=translation
    )  # fmt: skip


def tiles_of(one: Side, other: Side, slot: str, differs: str) -> Tiles:
    """A slot of both and their difference, or all slots of both for ""."""
    told = f"A (now) and B (held) on frame {one.frame}: {differs}"
    if other.problem not in ("", WORKING):
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
    ours, theirs = one.figures_of(slot), other.figures_of(slot)
    figures = {name: ours[name] - theirs[name] for name in ours if name in theirs}
    told = " · ".join(f"{name} {value:+.3g}" for name, value in figures.items())
    gap = None if a is None or b is None else difference(a, b, words="A less B", fits=True)
    if gap is None:
        why = "" if b is None else "these two cannot be subtracted: they have other pixels, or no common scale"
        return Tile(title="A less B", told=told, figures=figures, problem=why)
    return Tile(title="A less B", told=told, figures=figures, picture=a, truth=b, gap=gap, usual="difference")
