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
    build_recorded_touch,
    build_without_truth,
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
from pipeline.views.preview import Preview
from pipeline.views.tile import Tile

SortOrder = Literal["worst first", "best first", "in order"]
_STAGE = "touch"
# metric of a tile -> how its subtitle states it; in contact, and over the whole image
_METRIC_FORMATS = {
    "contact_error_mm": "contact {}",
    "error_mm": "all {} mm",
    "psnr_db": "{} dB",
    "ssim": "SSIM {}",
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
    truth = _make_truth_preview(translation, frame, display)
    target = translation.target
    facts = [
        f"frame {frame}, {translation.source.title} to {target.title}: {len(variants)} methods"
    ]
    first: tuple[Tile, ...] = ()
    if truth is not None:
        first = (Tile(title="truth", subtitle=f"recorded by {target.title}", preview=truth),)
    else:
        facts.append(
            f"the recording does not hold {target.title}'s own frame, so errors are not known"
        )
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
        metrics = tile.metrics
        errors = (
            metrics.get("contact_error_mm"),
            metrics.get("error_mm"),
            -metrics.get("psnr_db", math.nan),
        )
        return next((e for e in errors if e is not None and math.isfinite(e)), math.nan)

    if order == "in order":
        return list(tiles)
    sign = -1.0 if order == "worst first" else 1.0
    return sorted(
        tiles,
        key=lambda t: (
            math.isnan(get_error(t)),
            0.0 if math.isnan(get_error(t)) else sign * get_error(t),
        ),
    )


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
    touch = result.results[_STAGE].output
    assert isinstance(touch, GeneratedTouch)
    metrics = {} if recorded is None else _compute_metrics(runner, result, touch, recorded)
    words = [
        text.format(f"{metrics[name]:.3g}")
        for name, text in _METRIC_FORMATS.items()
        if name in metrics
    ]
    preview = _make_touch_preview(touch, result.variant.translation, display)
    return Tile(
        title=label,
        subtitle=" · ".join([*words, f"{result.ms:.0f} ms"]),
        metrics=metrics,
        preview=preview,
        truth=truth,
        difference=None if truth is None else compute_difference(preview, truth),
    )


def _compute_metrics(
    runner: VariantRunner, result: VariantResult, touch: GeneratedTouch, recorded: RecordedTouch
) -> dict[str, float]:
    """The finite metrics of a touch.

    A gel image without membrane is measured by the route's touch_depth stage.
    """
    translation = result.variant.translation
    touch_depth = touch.membrane
    if touch_depth is None and touch.image.ndim != 2 and "touch_depth" in translation.stages:
        output = (
            runner.evaluate(result.variant, result.frame, ["touch_depth"])
            .results["touch_depth"]
            .output
        )
        touch_depth = output if isinstance(output, DepthMap) else None
    everywhere = np.ones(recorded.contact.shape, np.bool_)
    change = compute_generated_change(touch, translation.target)
    pooled: Mapping[str, Mapping[str, float]] = pool_metrics(
        [compute_touch_metrics(change, touch_depth, recorded, everywhere, None)]
    )
    metrics = {
        name: pooled.get(name, {}).get("all", math.nan) for name in ("error_mm", "psnr_db", "ssim")
    }
    metrics["contact_error_mm"] = pooled.get("error_mm", {}).get("contact", math.nan)
    return {name: metrics[name] for name in _METRIC_FORMATS if math.isfinite(metrics[name])}


def _make_touch_preview(
    touch: GeneratedTouch, translation: Translation, display: DisplayParams
) -> Preview:
    """The touch as its column shows it."""
    return translation.catalogue.views[_STAGE].make_preview(
        touch, translation.make_preview_context({}, display)
    )


def _make_truth_preview(
    translation: Translation, frame: int, display: DisplayParams
) -> Preview | None:
    """What the target recorded, as the window shows it next to a generated touch.

    None if it recorded none.
    """
    truth = translation.read_ground_truth(frame)
    touch = translation.catalogue.stage(_STAGE).make_ground_truth(truth, translation.target)
    observation = truth.target_observation
    if (
        not isinstance(touch, GeneratedTouch)
        or observation is None
        or observation.reference is None
    ):
        return None
    return _make_touch_preview(touch, translation, display)


def _read_recorded_touch(translation: Translation, frame: int) -> RecordedTouch | None:
    """The target's frame of the same touch at its described size; None if it recorded none."""
    observed = translation.read_target_observation(frame)
    if observed is None or observed[0].reference is None:
        return None
    if observed[0].image.shape[:2] != translation.target.camera.shape:
        return None
    truth = observed[1]
    is_known = truth is not None and truth.indentation_mm is not None and truth.contact is not None
    target = translation.target
    return (
        build_recorded_touch(*observed, target)
        if is_known
        else build_without_truth(observed[0], target)
    )
