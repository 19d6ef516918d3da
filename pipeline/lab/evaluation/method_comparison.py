"""One frame's touch by every method that can generate it, compared with the target's recorded
touch.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap, GeneratedTouch
from pipeline.lab.evaluation.comparison_tiles import Comparison
from pipeline.lab.evaluation.touch_metrics import (
    RecordedTouch,
    Region,
    build_recorded_touch,
    compute_generated_change,
    compute_touch_metrics,
    pool_metrics,
)
from pipeline.lab.evaluation.variants import (
    MethodParams,
    VariantResult,
    VariantRunner,
    list_method_variants,
)
from pipeline.translation.translate import Translation
from pipeline.views.difference import compute_difference
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview, Tile

SortOrder = Literal["worst first", "best first", "in order"]
_STAGE = "touch"
# metric of a tile -> the touch metric and region that it is, and how its subtitle states it
_METRICS: Mapping[str, tuple[str, Region, str]] = {
    "contact_error_mm": ("error_mm", "contact", "contact {:.3g}"),
    "error_mm": ("error_mm", "all", "all {:.3g} mm"),
    "psnr_db": ("psnr_db", "all", "{:.3g} dB"),
    "ssim": ("ssim", "all", "SSIM {:.3g}"),
}


def compare_methods(
    runner: VariantRunner,
    translation: Translation,
    frame: int,
    params: MethodParams,
    display: DisplayParams,
    order: str,
    progress: Progress = SILENT,
) -> Iterator[Comparison]:
    """Tiles of ground truth and of every touch method, one method more each time. Raises
    TouchError, Cancelled.
    """
    variants, excluded = list_method_variants(translation, params, _STAGE)
    recorded = _read_recorded_touch(translation, frame)
    truth = None
    true = translation.read_true_outputs(frame).get(_STAGE)
    if recorded is not None and true is not None:
        context = translation.make_preview_context({}, display)
        truth = translation.catalogue.views[_STAGE].make_preview(true, context)
    title = translation.target.title
    facts = [f"frame {frame}, {translation.source.title} to {title}: {len(variants)} methods"]
    first: tuple[Tile, ...] = ()
    if truth is not None:
        first = (Tile(title="truth", subtitle=f"recorded by {title}", preview=truth),)
    else:
        facts.append(f"the recording does not hold {title}'s own frame, so errors are not known")
    tiles = list[Tile]()
    left_out = list(excluded)

    def collect() -> Comparison:
        summary = [*facts, f"left out: {'; '.join(left_out)}"] if left_out else facts
        return Comparison(tiles=(*first, *sort_tiles(tiles, order)), summary=" · ".join(summary))

    yield collect()
    for result in runner.evaluate_all(variants, frame, [_STAGE], progress):
        tile = _make_tile(runner, result, recorded, truth, display)
        if tile.problem:
            left_out.append(f"{tile.title}: {tile.problem.partition(';')[0]}")
        else:
            tiles.append(tile)
        yield collect()


def sort_tiles(tiles: Sequence[Tile], order: str) -> list[Tile]:
    """Tiles by their error in contact, else over the whole image, else by PSNR.

    Those without any come last.
    """

    def get_error(tile: Tile) -> float:
        name = next(name for name in _METRICS if name in tile.metrics)
        return -tile.metrics[name] if name == "psnr_db" else tile.metrics[name]

    if order == "in order":
        return list(tiles)
    known = [tile for tile in tiles if _METRICS.keys() & tile.metrics.keys()]
    known.sort(key=get_error, reverse=order == "worst first")
    return [*known, *(tile for tile in tiles if not _METRICS.keys() & tile.metrics.keys())]


def _make_tile(
    runner: VariantRunner,
    result: VariantResult,
    recorded: RecordedTouch | None,
    truth: Preview | None,
    display: DisplayParams,
) -> Tile:
    label = result.variant.label
    if result.problem or result.results[_STAGE].fallback:
        return Tile(title=label, problem=result.problem or result.results[_STAGE].fallback)
    metrics = {} if recorded is None else _compute_metrics(runner, result, recorded)
    words = [_METRICS[name][2].format(value) for name, value in metrics.items()]
    preview = result.make_preview(_STAGE, display)
    return Tile(
        title=label,
        subtitle=" · ".join([*words, f"{result.ms:.0f} ms"]),
        metrics=metrics,
        preview=preview,
        truth=truth,
        difference=None if truth is None else compute_difference(preview, truth),
    )


def _compute_metrics(
    runner: VariantRunner, result: VariantResult, recorded: RecordedTouch
) -> dict[str, float]:
    """The finite metrics of a touch.

    A gel image without membrane is measured by the route's touch_depth stage.
    """
    translation = result.variant.translation
    touch = result.results[_STAGE].output
    assert isinstance(touch, GeneratedTouch)
    touch_depth = touch.membrane
    if touch_depth is None and touch.image.ndim != 2 and "touch_depth" in translation.stages:
        read = runner.evaluate(result.variant, result.frame, ["touch_depth"])
        output = read.results["touch_depth"].output
        touch_depth = output if isinstance(output, DepthMap) else None
    everywhere = np.ones(recorded.contact.shape, np.bool_)
    change = compute_generated_change(touch, translation.target)
    pooled = pool_metrics([compute_touch_metrics(change, touch_depth, recorded, everywhere, None)])
    return {
        name: pooled[metric][region]
        for name, (metric, region, _) in _METRICS.items()
        if math.isfinite(pooled.get(metric, {}).get(region, math.nan))
    }


def _read_recorded_touch(translation: Translation, frame: int) -> RecordedTouch | None:
    """The target's frame of the same touch at its described size; None if it recorded none."""
    observed = translation.read_target_observation(frame)
    target = translation.target
    if observed is None or observed[0].reference is None:
        return None
    if observed[0].image.shape[:2] != target.camera.shape:
        return None
    truth = observed[1]
    if truth is None or truth.indentation_mm is None or truth.contact is None:
        return build_recorded_touch(observed[0], target)
    return build_recorded_touch(observed[0], target, truth.indentation_mm, truth.contact)
