"""Two variants on one frame: each stage of both, and the difference of one stage."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace

from pipeline.core.errors import SettingProblem, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.pairing import NO_PARTNER, pair_frames
from pipeline.lab.evaluation.comparison_tiles import Comparison
from pipeline.lab.evaluation.variants import Variant, VariantRunner
from pipeline.stages.metrics.stage_metrics import METRICS
from pipeline.translation.translate import Translation
from pipeline.translation.truth_view import TruthView, add_truth_warnings, build_truth_view
from pipeline.views.contrast import share_scale
from pipeline.views.difference import compute_difference
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview, Tile, make_recorded_preview

SOURCE = "source"
IN_PROGRESS = "working…"
_DIFFERENCE = "A minus B"


@frozen
class StageView:
    """Preview of one stage; without a result those of the source frame."""

    preview: Preview
    result: StageResult | None = None
    truth_view: TruthView | None = None


@frozen
class VariantView:
    """All views of one variant; without views there is only `problem`."""

    label: str
    stages: Mapping[str, StageView] = field(default_factory=dict[str, StageView])
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])  # stage.name -> value
    titles: Mapping[str, str] = field(default_factory=dict[str, str])  # stage -> title
    translation: Translation | None = None
    problem: str = ""

    def build_tile(self, stage: str, *, starts_row: bool = False) -> Tile:
        """A stage's preview with its metrics and warnings."""
        view = self.stages.get(stage)
        tile = Tile(title=f"{self.label} · {self.titles.get(stage, stage)}", starts_row=starts_row)
        if view is None:
            return replace(tile, problem=self.problem or "this route does not have it")
        metrics = self.stage_metrics(stage)
        result = view.result
        truth = view.truth_view
        words = _format_metrics(metrics, "")
        return replace(
            tile,
            subtitle=" · ".join([*words, *(() if result is None else result.warnings)]),
            metrics=metrics,
            preview=view.preview,
            truth=truth and truth.truth,
            difference=truth and truth.difference_to_truth,
            problem="" if result is None else result.fallback,
        )

    def stage_metrics(self, stage: str) -> dict[str, float]:
        """Name -> value of one stage's metrics."""
        start = f"{stage}."
        return {
            name.removeprefix(start): value
            for name, value in self.metrics.items()
            if name.startswith(start)
        }


def compare_pair(
    runner: VariantRunner,
    first: Variant,
    open_second: Callable[[], Variant],
    frame: int,
    display: DisplayParams,
    stage: str,
    differs: str,
    progress: Progress = SILENT,
    *,
    second_may_fail: bool = False,
) -> Iterator[Comparison]:
    """Yield the comparison of two variants at one frame: first while the second is computed, then
    whole.

    `stage` is the compared stage, "" for all; `differs` says in words what differs between the
    variants. Raises TouchError. If `second_may_fail`, an error of the second is shown in its place
    instead.
    """
    one = evaluate_view(runner, first, frame, display, stage, progress)
    yield build_tiles(
        one, VariantView(label="B", titles=one.titles, problem=IN_PROGRESS), frame, stage, differs
    )
    try:
        second = open_second()
        moment = find_same_moment(first.translation, second.translation, frame)
        other = evaluate_view(runner, second, moment, display, stage, progress)
    except TouchError as error:
        if not second_may_fail:
            raise
        other = VariantView(label="B", titles=one.titles, problem=str(error))
    yield build_tiles(one, other, frame, stage, differs)


def find_same_moment(one: Translation, other: Translation, frame: int) -> int:
    """The frame of another translation that shows what `frame` shows: its partner in another stream
    of the recording.

    In another recording it is the frame of the same number. Raises SettingProblem where there is
    none.
    """
    if one.request.recording != other.request.recording or one.stream.name == other.stream.name:
        return other.check_index(frame)
    partner = int(pair_frames(one.stream, other.stream).partners[frame])
    if partner == NO_PARTNER:
        raise SettingProblem(
            f"{other.stream.name!r} recorded no frame at the time of frame {frame}; choose "
            "another one"
        )
    return partner


def evaluate_view(
    runner: VariantRunner,
    variant: Variant,
    frame: int,
    display: DisplayParams,
    stage: str,
    progress: Progress = SILENT,
) -> VariantView:
    """The source frame and one stage, or all stages for "". Raises TouchError."""
    translation = variant.translation
    source = translation.source
    truth = translation.read_ground_truth(translation.check_index(frame))
    recorded = translation.stream.frame(frame)
    preview, _ = make_recorded_preview(recorded, source, display)
    views = {SOURCE: StageView(preview=preview)}
    requested = [name for name in translation.stages if stage in ("", name)]
    result = runner.evaluate(variant, frame, requested, progress)
    results = {name: add_truth_warnings(each, truth) for name, each in result.results.items()}
    context = result.make_context(display)
    true_outputs = translation.read_true_outputs(frame)
    for name, each in results.items():
        view = translation.catalogue.views[name]
        preview = view.make_preview(each.output, context)
        views[name] = StageView(
            preview=preview,
            result=each,
            truth_view=build_truth_view(name, view, preview, true_outputs, context),
        )
    titles = {
        SOURCE: "Source",
        **{name: translation.catalogue.stage(name).title for name in translation.stages},
    }
    metrics = translation.compute_metrics_against(results, truth)
    return VariantView(
        label=variant.label, stages=views, metrics=metrics, titles=titles, translation=translation
    )


def build_tiles(
    one: VariantView, other: VariantView, frame: int, stage: str, differs: str
) -> Comparison:
    """A stage of both and their difference, or all stages of both for ""."""
    summary = f"A and B on frame {frame}: {differs}"
    one, other = _share_scales(one, other)
    if other.problem not in ("", IN_PROGRESS):
        summary = f"{summary} · B: {other.problem}"
    names = [stage] if stage else list(dict.fromkeys((*one.stages, *other.stages)))
    tiles = [
        view.build_tile(name, starts_row=not stage and name == names[0])
        for view in (one, other)
        for name in names
    ]
    if stage:
        tiles.append(_build_difference_tile(one, other, stage))
    return Comparison(tiles=tuple(tiles), summary=summary)


def _share_scales(one: VariantView, other: VariantView) -> tuple[VariantView, VariantView]:
    """Both variants with one colour scale per stage, also where their sensors have other ranges."""
    both = one.stages.keys() & other.stages.keys()
    shared = {
        name: share_scale(one.stages[name].preview, other.stages[name].preview) for name in both
    }

    def recolour(view: VariantView, which: int) -> VariantView:
        changed = {
            name: replace(view.stages[name], preview=previews[which])
            for name, previews in shared.items()
        }
        return replace(
            view, stages={name: changed.get(name, each) for name, each in view.stages.items()}
        )

    return recolour(one, 0), recolour(other, 1)


def _build_difference_tile(one: VariantView, other: VariantView, stage: str) -> Tile:
    """A minus B; wipe and blink alternate between the two."""
    a, b = (view.stages[stage].preview if stage in view.stages else None for view in (one, other))
    values = one.stage_metrics(stage)
    reference = other.stage_metrics(stage)
    metrics = {name: values[name] - reference[name] for name in values if name in reference}
    subtitle = " · ".join(_format_metrics(metrics, "+"))
    tile = Tile(title=_DIFFERENCE, subtitle=subtitle, metrics=metrics)
    if b is None:
        return tile
    difference = None if a is None else compute_difference(a, b, label=_DIFFERENCE)
    if difference is None:
        problem = "no difference: the two have other pixels, or no common scale"
        return replace(tile, problem=problem)
    return replace(tile, preview=a, truth=b, difference=difference, default_mode="difference")


def _format_metrics(metrics: Mapping[str, float], sign: str) -> list[str]:
    """Metrics by their titles, with their units."""
    return [
        f"{METRICS[name].title} {value:{sign}.3g} {METRICS[name].unit}".rstrip()
        for name, value in metrics.items()
    ]
