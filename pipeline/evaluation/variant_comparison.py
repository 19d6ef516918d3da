"""Two translations on one frame: each slot of one beside that of the other, and what the one is less the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Graph, StageResult
from pipeline.evaluation.comparison_tiles import ComparisonTiles
from pipeline.evaluation.truth_view import TruthView, build_truth_view
from pipeline.previews.difference import compute_difference
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.layers import Layer, make_frame_layer
from pipeline.previews.preview import Preview, make_frame_preview, match_camera
from pipeline.previews.tile import Tile
from pipeline.stages.stage import PreviewContext
from pipeline.translation.translate import Translation
from pipeline.translation.truth_warnings import add_truth_warnings

SOURCE = "source"
IN_PROGRESS = "working…"


@dataclass(frozen=True, slots=True, kw_only=True)
class StageView:
    """One slot of one of the two, drawn; without a result it is the reading itself."""

    preview: Preview
    layers: tuple[Layer, ...]
    result: StageResult | None = None
    truth_view: TruthView | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One of the two, worked out; without parts there is only `problem`."""

    label: str
    frame: int = -1
    stages: Mapping[str, StageView] = field(default_factory=dict[str, StageView])
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])  # slot.name -> value
    titles: Mapping[str, str] = field(default_factory=dict[str, str])
    translation: Translation | None = None
    problem: str = ""

    def build_tile(self, stage: str, *, apart: bool = False) -> Tile:
        """A slot's picture with its figures."""
        part, title = self.stages.get(stage), f"{self.label} · {self.titles.get(stage, stage)}"
        if part is None:
            return Tile(title=title, problem=self.problem or "this route does not have it", starts_row=apart)
        figures, result, other = self.stage_metrics(stage), part.result, part.truth_view
        words = [f"{name} {value:.3g}" for name, value in figures.items()]
        return Tile(
            title=title, subtitle=" · ".join([*words, *(() if result is None else result.warnings)]), metrics=figures,
            preview=part.preview, truth=None if other is None else other.truth,
            difference=None if other is None else other.difference_to_truth, problem="" if result is None else result.fallback, starts_row=apart,
        )  # fmt: skip

    def stage_metrics(self, stage: str) -> dict[str, float]:
        """What is known of a slot's error."""
        return {
            name.partition(".")[2]: value for name, value in self.metrics.items() if name.partition(".")[0] == stage
        }

    def stage_preview(self, stage: str) -> Preview | None:
        """What is shown of a slot."""
        part = self.stages.get(stage)
        return None if part is None else part.preview

    def stage_layers(self, stage: str) -> tuple[Layer, ...]:
        """The same in 3D."""
        part = self.stages.get(stage)
        return () if part is None else part.layers


def evaluate_variant(
    letter: str, translation: Translation, frame: int, given: Mapping[str, object], display: DisplayParams, stage: str,
    graph: Graph, progress: Progress = SILENT,
) -> Variant:  # fmt: skip
    """A slot of a frame, or all slots for ""; `given` are parameters of methods by key. Raises TouchError."""
    source, facts = translation.source, translation.read_ground_truth(translation.check_index(frame))
    reading = translation.stream.frame(frame)
    camera = match_camera(reading.camera or source.camera, reading.image.shape)
    picture = make_frame_preview(reading.image, camera, source, display, reference=reading.reference)
    layer = make_frame_layer(SOURCE, reading.image, camera, picture.pixels, source)
    parts = {SOURCE: StageView(preview=picture, layers=(layer,))}
    params = {m.stage: given.get(m.key, m.params()) for m in translation.methods}
    wanted = [name for name in translation.stages if stage in ("", name)]
    found = graph.evaluate(wanted, translation.build_inputs(reading), params, progress)
    results = {name: add_truth_warnings(result, facts) for name, result in found.items()}
    seen = PreviewContext(
        outputs={name: result.output for name, result in results.items()}, source=source, target=translation.target,
        mesh=translation.mesh, display=display,
    )  # fmt: skip
    truths = translation.read_true_outputs(frame)
    for name, result in results.items():
        entry = translation.catalogue.stage(name)
        made = entry.make_preview(result.output, seen)
        layers = entry.make_layers(result.output, seen, made)
        parts[name] = StageView(
            preview=made, layers=layers, result=result, truth_view=build_truth_view(entry, made, truths, seen)
        )
    titles = {SOURCE: "Source", **{name: translation.catalogue.stage(name).title for name in translation.stages}}
    figures = translation.compute_metrics_against(results, facts)
    return Variant(
        label=letter, frame=frame, stages=parts, metrics=figures, titles=titles, translation=translation
    )  # fmt: skip


def build_tiles(one: Variant, other: Variant, stage: str, differs: str) -> ComparisonTiles:
    """A slot of both and their difference, or all slots of both for ""."""
    told = f"A (now) and B (held) on frame {one.frame}: {differs}"
    if other.problem not in ("", IN_PROGRESS):
        told = f"{told} · B: {other.problem}"
    if not stage:
        names = list(dict.fromkeys((*one.stages, *other.stages)))
        rows = [side.build_tile(name, apart=name == names[0]) for side in (one, other) for name in names]
        return ComparisonTiles(tiles=tuple(rows), summary=told)
    return ComparisonTiles(
        tiles=(one.build_tile(stage), other.build_tile(stage), _less(one, other, stage)), summary=told,
        stage=stage, views_3d=tuple((side.stage_layers(stage), side.translation) for side in (one, other)),
    )  # fmt: skip


def _less(one: Variant, other: Variant, stage: str) -> Tile:
    """The first less the second; a wipe and blinking are between the two."""
    a, b = one.stage_preview(stage), other.stage_preview(stage)
    ours, theirs = one.stage_metrics(stage), other.stage_metrics(stage)
    figures = {name: ours[name] - theirs[name] for name in ours if name in theirs}
    told = " · ".join(f"{name} {value:+.3g}" for name, value in figures.items())
    gap = None if a is None or b is None else compute_difference(a, b, label="A less B", fit_scale=True)
    if gap is None:
        why = "" if b is None else "these two cannot be subtracted: they have other pixels, or no common scale"
        return Tile(title="A less B", subtitle=told, metrics=figures, problem=why)
    return Tile(
        title="A less B", subtitle=told, metrics=figures, preview=a, truth=b, difference=gap, default_mode="difference"
    )
