"""One frame several ways, as tiles: the touch by every method that can make it, beside the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from pipeline.base.progress import SILENT, Progress
from pipeline.evaluation.comparison_tiles import ComparisonTiles, TilesCallback, ignore_tiles
from pipeline.evaluation.method_results import MethodCache, MethodResult, evaluate_methods, list_available_methods
from pipeline.previews.difference import compute_difference
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.preview import Preview, make_frame_preview
from pipeline.previews.tile import Tile
from pipeline.stages.stage import GroundTruth
from pipeline.translation.translate import Translation
from pipeline.values.results import GeneratedTouch

_NO_TRUTH = "the recording does not hold what {target} felt, so that no error is known"


def compare_methods(
    translation: Translation, frame: int, params: Mapping[str, object], display: DisplayParams, order: str, kept: MethodCache,
    *, hand_over: TilesCallback = ignore_tiles, progress: Progress = SILENT,
) -> ComparisonTiles:  # fmt: skip
    """A frame by every method of its touch, handed over one by one; `params` of methods by key. Raises TouchError."""
    facts = translation.read_ground_truth(frame)
    true = _truth(translation, facts, display)
    ways = list_available_methods(translation)
    first = () if true is None else (Tile(title="truth", subtitle=f"{translation.target.title}'s own", preview=true),)
    begun = ComparisonTiles(
        tiles=first,
        summary=_sentence(translation, frame, len(ways.translations), ways.excluded, known=true is not None),
    )
    hand_over(begun)
    found: list[MethodResult] = []
    shown = begun
    for version in evaluate_methods(translation, frame, params, kept, progress):
        found.append(version)
        tiles = tuple(_tile(v, translation, true, display) for v in sort_results(found, order))
        shown = replace(begun, tiles=(*first, *tiles))
        hand_over(shown)
    return shown


def sort_results(found: Sequence[MethodResult], order: str) -> list[MethodResult]:
    """By what their touch is off where it really is, those of which that is not known last."""

    def error(version: MethodResult) -> float:
        known = [e for e in (version.contact_error_mm, version.error_mm, -version.psnr_db) if math.isfinite(e)]
        return known[0] if known and not version.problem else math.nan

    if order == "in order":
        return list(found)
    sign = -1.0 if order == "worst first" else 1.0
    return sorted(found, key=lambda v: (math.isnan(error(v)), sign * error(v) if math.isfinite(error(v)) else 0.0))


def format_metrics(version: MethodResult) -> str:
    """The figures in a line; those that are not known are left out."""
    parts = [
        words.format(f"{value:.3g}")
        for value, words in (
            (version.contact_error_mm, "contact {}"), (version.error_mm, "all {} mm"), (version.psnr_db, "{} dB"),
            (version.ssim, "SSIM {}"),
        )
        if math.isfinite(value)
    ]  # fmt: skip
    return " · ".join([*parts, f"{version.ms:.0f} ms"] if math.isfinite(version.ms) else parts)


def _figures(version: MethodResult) -> dict[str, float]:
    """Those that another run has too: no times."""
    known = {
        "contact_error_mm": version.contact_error_mm, "error_mm": version.error_mm, "psnr_db": version.psnr_db,
        "ssim": version.ssim,
    }  # fmt: skip
    return {name: value for name, value in known.items() if math.isfinite(value)}


def _tile(version: MethodResult, translation: Translation, true: Preview | None, display: DisplayParams) -> Tile:
    if version.touch is None or version.problem:
        return Tile(title=version.method.title, problem=version.problem)
    made = _drawn(version.touch, translation, display)
    return Tile(
        title=version.method.title, subtitle=format_metrics(version), metrics=_figures(version), preview=made, truth=true,
        difference=None if true is None else compute_difference(made, true),
    )  # fmt: skip


def _drawn(touch: GeneratedTouch, translation: Translation, display: DisplayParams) -> Preview:
    """As the slot of touches shows it."""
    membrane = touch.membrane
    return make_frame_preview(
        touch.image, touch.camera, translation.target, display, reference=touch.reference, is_recorded=False,
        depth_mm=None if membrane is None else membrane.depth_mm,
        contact=None if membrane is None else membrane.contact,
    )  # fmt: skip


def _truth(translation: Translation, facts: GroundTruth, display: DisplayParams) -> Preview | None:
    """What the target felt itself, drawn as the methods' answers are; None where it took no part."""
    slot = translation.catalogue.stage("touch")
    true = slot.make_ground_truth(facts, translation.target)
    frame = facts.target_observation
    if not isinstance(true, GeneratedTouch) or frame is None or frame.reference is None:
        return None
    if true.membrane is not None and true.image.ndim == 2:  # without the camera's noise, as its error is taken
        true = replace(true, image=true.membrane.depth_mm, camera=true.membrane.camera, reference=None)
    return _drawn(true, translation, display)


def _sentence(translation: Translation, frame: int, count: int, absent: Sequence[str], *, known: bool) -> str:
    words = [f"frame {frame}, {translation.source.title} to {translation.target.title}: {count} methods"]
    if not known:
        words.append(_NO_TRUTH.format(target=translation.target.title))
    if absent:
        words.append(f"left out: {'; '.join(absent)}")
    return " · ".join(words)
