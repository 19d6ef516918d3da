"""Previews and 3D layers of stage results, cached so that playing and stepping back reuse them."""

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from app.session.state import Session
from app.views.target_comparison import TargetComparison
from pipeline.core.arrays import Image, freeze
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult
from pipeline.core.memo import Memo, measure_bytes
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.stages.stage import GroundTruth
from pipeline.translation.round_trip import measure_training_distance
from pipeline.translation.translate import Translation
from pipeline.translation.truth_view import TruthView, build_truth_view
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import Layer, make_frame_layer
from pipeline.views.preview import (
    Preview,
    add_observed_outline,
    compute_pixel_mm,
    make_recorded_preview,
)
from pipeline.views.view import StepHistory, View
from widgets.frames.frame_summary import THUMBNAIL_PX, FrameSummary
from widgets.style.theme import DARK_COLOURS
from widgets.views.preview_renderer import recolour_for_theme

_PREVIEW_BYTES = 49 * 1024 * 1024  # 16 frames from a 320 x 427 gel to a bubble, 7 images each
_FRAME_BYTES = _TRUTH_BYTES = 26 * 1024 * 1024
_MAX_METRICS = 512  # frames whose metrics are kept


@frozen
class SourcePreview:
    """Preview and layers of the recorded frame."""

    frame: TactileFrame
    ground_truth: GroundTruth
    preview: Preview
    layers: tuple[Layer, ...]
    display: DisplayParams  # used for the preview
    read_ms: float = 0.0  # time to read the frame


@frozen
class StagePreview:
    """Preview and layers of one stage result."""

    result: StageResult
    preview: Preview
    layers: tuple[Layer, ...]
    truth_view: TruthView | None = None  # if requested and known
    step_previews: tuple[Preview, ...] = ()  # of the kept steps
    # of the kept steps; an empty entry has no 3D layer
    step_layers: tuple[tuple[Layer, ...], ...] = ()
    step_history: StepHistory | None = None


class PreviewCache:
    """Frames, previews and metrics of one translation; used by one thread at a time."""

    def __init__(self, most_bytes: int = _PREVIEW_BYTES) -> None:
        self._previews: Memo[object, StagePreview] = Memo(most_bytes=most_bytes, weigh=_size_bytes)
        # Stage key -> (comparison, truths, preview): a hit needs the same comparison and truths.
        self._compared: Memo[object, tuple[object, object, StagePreview]] = Memo(
            most_bytes=min(most_bytes, _TRUTH_BYTES), weigh=lambda entry: _size_bytes(entry[2])
        )
        self._frames: Memo[int, SourcePreview] = Memo(
            most_bytes=min(most_bytes, _FRAME_BYTES), weigh=_size_loaded_bytes
        )
        self._metrics: Memo[object, dict[str, float]] = Memo(_MAX_METRICS)

    def load_frame(
        self, translation: Translation, index: int, display: DisplayParams
    ) -> SourcePreview:
        """Return a frame with its ground truth and preview, cached unless the recording is live."""
        started_s = time.perf_counter()
        loaded = self._frames.get(index)
        # colour maps apply to depth only
        if loaded is None or (loaded.frame.is_depth and loaded.display != display):
            frame = translation.stream.frame(translation.check_index(index))
            preview, camera = make_recorded_preview(frame, translation.source, display)
            layer = make_frame_layer("source", frame.image, camera, preview, translation.source)
            loaded = SourcePreview(
                frame=frame,
                ground_truth=translation.read_ground_truth(index),
                preview=preview,
                layers=(layer,),
                display=display,
            )
            # the zero and the oldest frames of a live recording change
            if translation.recording.refresh is None:
                self._frames.put(index, loaded)
        return replace(loaded, read_ms=1e3 * (time.perf_counter() - started_s))

    def compute_metrics(
        self,
        translation: Translation,
        results: Mapping[str, StageResult],
        index: int,
        truth: GroundTruth,
    ) -> dict[str, float]:
        """Return metric -> value of a frame, cached by the digests of its results."""
        key = (index, *((name, result.digest) for name, result in results.items()))
        metrics = self._metrics.get(key)
        if metrics is None:
            metrics = translation.compute_metrics_against(results, truth)
            self._metrics.put(key, metrics)
        return metrics

    def draw_stage(
        self,
        result: StageResult,
        results: Mapping[str, StageResult],
        translation: Translation,
        session: Session,
        other: TargetComparison | None,
        truths: Mapping[str, object] | None,
    ) -> StagePreview:
        """Return the preview of a result.

        Equal results return the same images, which the window need not redraw.
        """
        view = translation.catalogue.views[result.name]
        inputs = tuple(results[name].digest for name in view.preview_stages if name in results)
        n_steps = len(getattr(result.output, "steps", ()))  # not part of the digest
        key = (result.name, result.digest, n_steps, session.display, inputs)
        cached = None if truths is None and other is None else self._compared.get(key)
        if cached is not None and cached[0] is other and cached[1] is truths:
            return replace(cached[2], result=result)
        shown = self._previews.get_or_make(
            key, lambda: _draw_stage(view, result, results, translation, session)
        )
        if truths is not None or other is not None:
            shown = _add_comparison(view, shown, results, translation, session, other, truths)
            self._compared.put(key, (other, truths, shown))
        return replace(shown, result=result)


def _draw_stage(
    view: View,
    result: StageResult,
    results: Mapping[str, StageResult],
    translation: Translation,
    session: Session,
) -> StagePreview:
    context = translation.make_preview_context(results, session.display)
    preview = view.make_preview(result.output, context)
    steps = [(step, view.make_preview(step, context)) for step in view.split_steps(result.output)]
    return StagePreview(
        result=result,
        preview=preview,
        layers=view.make_layers(result.output, context, preview),
        step_previews=tuple(shown for _, shown in steps),
        step_layers=tuple(view.make_step_layers(step, context, shown) for step, shown in steps),
        step_history=view.summarise_steps(result.output),
    )


def _size_bytes(shown: StagePreview) -> int:
    """Size without the result itself, which the graph's cache counts."""
    return measure_bytes(
        (shown.preview, shown.layers, shown.truth_view, shown.step_previews, shown.step_layers),
        shown.result.output,
    )


def _size_loaded_bytes(loaded: SourcePreview) -> int:
    """Size without what all frames of a recording share."""
    frame, truth = loaded.frame, loaded.ground_truth
    observed = truth.target_observation
    reference = None if observed is None else observed.reference
    shape = [replace(layer, rgb=np.empty((0, 3), np.uint8)) for layer in loaded.layers]
    at_rest = () if frame.is_depth else shape
    return measure_bytes(loaded, (frame.reference, truth.mesh, reference, at_rest))


def _add_comparison(
    view: View,
    shown: StagePreview,
    results: Mapping[str, StageResult],
    translation: Translation,
    session: Session,
    other: TargetComparison | None,
    truths: Mapping[str, object] | None,
) -> StagePreview:
    """Add the target's own touch if it is compared, else the truth if it is requested."""
    preview = shown.preview
    if other is not None and other.paired_touch is not None:
        outlined = add_observed_outline(preview, other.observed_outline_px)
        observed = other.view_observation(preview, session.display)
        return replace(shown, preview=outlined, truth_view=observed)
    if truths is None:
        return shown
    context = translation.make_preview_context(results, session.display)
    truth = build_truth_view(shown.result.name, view, preview, truths, context)
    return replace(shown, truth_view=truth)


def _shrink(pixels: Image) -> Image:
    import cv2

    rows, cols = pixels.shape[:2]
    share = min(THUMBNAIL_PX[0] / cols, THUMBNAIL_PX[1] / rows)
    size = max(1, round(share * cols)), max(1, round(share * rows))
    return freeze(np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8))


def summarise_frame(
    results: Mapping[str, StageResult],
    metrics: Mapping[str, float],
    translation: Translation,
    preview: Preview,
) -> FrameSummary:
    """Summarise a frame for the frames table, with small images of its preview."""
    pixels, scale = preview.pixels, preview.scale
    dark = None if scale is None else _shrink(recolour_for_theme(pixels, scale, DARK_COLOURS))
    summary = FrameSummary(metrics=metrics, thumbnail=_shrink(pixels), dark_thumbnail=dark)
    depth = results["depth"].output if "depth" in results else None
    if not isinstance(depth, DepthMap):
        return summary
    inside = depth.indentation_mm[depth.contact]
    pixel_mm = compute_pixel_mm(depth.camera, translation.source)
    return replace(
        summary,
        max_indentation_mm=float(np.nanmax(inside, initial=0.0)),
        contact_area_mm2=float(depth.contact.sum()) * pixel_mm**2,
        metrics={**metrics, **measure_training_distance(results, translation)},
        warnings=tuple(
            f"{translation.catalogue.stage(name).title.lower()}: {warning}"
            for name, result in results.items()
            for warning in result.warnings
        ),
    )
