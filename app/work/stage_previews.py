"""From results to finished pictures and layers, each made once: who plays or goes back sees the very same again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from app.session.state import Session
from app.work.target_comparison import TargetComparison
from pipeline.base.memo import Memo, measure_bytes
from pipeline.engine.graph import StageResult
from pipeline.evaluation.truth_view import TruthView, build_observation_view
from pipeline.evaluation.truth_view import build_truth_view as beside_truth
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.layers import Layer, make_frame_layer
from pipeline.previews.preview import Preview, add_observed_outline, make_frame_preview, match_camera
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.stage import GroundTruth, PreviewContext, Stage, StepHistory
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap
from widgets.frames_model import FrameSummary

_DRAWN_BYTES = 72 * 1024 * 1024  # a dozen frames to a gel of 320 x 427, seven pictures each
_READ_BYTES = _BESIDE_BYTES = 40 * 1024 * 1024
_MOST_JUDGED = 512


@dataclass(frozen=True, slots=True, kw_only=True)
class SourcePreview:
    """The frame itself, before any method."""

    frame: TactileFrame
    ground_truth: GroundTruth  # what is known of it
    preview: Preview
    layers: tuple[Layer, ...]
    read_ms: float  # reading it


@dataclass(frozen=True, slots=True, kw_only=True)
class StagePreview:
    """One slot's result, drawn."""

    result: StageResult
    preview: Preview
    layers: tuple[Layer, ...]
    truth_view: TruthView | None = None  # where it was asked for and is known
    step_previews: tuple[Preview, ...] = ()  # kept on the way to it, where they are pictures of their own,
    step_layers: tuple[tuple[Layer, ...], ...] = ()  # in 3D, each empty where it is not drawn,
    step_history: StepHistory | None = None  # and what is told of them all


class LoadedFrame(NamedTuple):
    """A frame as it was read and drawn, and what is known of it."""

    frame: TactileFrame
    ground_truth: GroundTruth
    preview: Preview
    layer: Layer
    display: DisplayParams  # that it was drawn with


class PreviewCache:
    """What was read, drawn and judged of one translation; used by one thread at a time."""

    def __init__(self, most_bytes: int = _DRAWN_BYTES) -> None:
        self._drawn: Memo[object, StagePreview] = Memo(most_bytes=most_bytes, weigh=_weight)
        # Beside a truth or what was felt: with those, since equal keys may stand beside others.
        self._beside: Memo[object, tuple[object, object, StagePreview]] = Memo(
            most_bytes=min(most_bytes, _BESIDE_BYTES), weigh=lambda kept: _weight(kept[2])
        )
        self._read: Memo[int, LoadedFrame] = Memo(most_bytes=min(most_bytes, _READ_BYTES))
        self._judged: Memo[object, dict[str, float]] = Memo(_MOST_JUDGED)

    def load_frame(self, translation: Translation, index: int, display: DisplayParams) -> LoadedFrame:
        """A frame with all that is known of it, kept: who plays or goes back asks for it again."""
        kept = self._read.get(index)
        if kept is None or (kept.frame.is_depth and kept.display != display):  # a gel's colours are its own
            frame = translation.stream.frame(translation.check_index(index)) if kept is None else kept.frame
            facts = translation.read_ground_truth(index) if kept is None else kept.ground_truth
            kept = LoadedFrame(frame, facts, *_reading(frame, translation.source, display), display)
            if translation.recording.refresh is None:  # one that grows may be set to zero anew, or forget its oldest
                self._read.put(index, kept)
        return kept

    def compute_metrics(
        self, translation: Translation, results: Mapping[str, StageResult], index: int, facts: GroundTruth
    ) -> dict[str, float]:
        """The frame's figures; equal answers have equal ones, and are not judged again."""
        key = (index, *((name, result.digest) for name, result in results.items()))
        known = self._judged.get(key)
        if known is None:
            known = translation.compute_metrics_against(results, facts)
            self._judged.put(key, known)
        return known

    def draw_stage(
        self,
        result: StageResult,
        results: Mapping[str, StageResult],
        translation: Translation,
        session: Session,
        other: TargetComparison | None,
        truths: Mapping[str, object] | None,
    ) -> StagePreview:
        """Pictures of an output that was drawn before are used again, so that the window need not touch them."""
        slot = translation.catalogue.stage(result.name)
        also = tuple(results[name].digest for name in slot.preview_stages if name in results)
        n_kept = len(getattr(result.output, "steps", ()))  # which the digest does not count
        key = (result.name, result.digest, n_kept, session.display, also)
        beside = None if truths is None and other is None else self._beside.get(key)
        if beside is not None and beside[0] is other and beside[1] is truths:
            return replace(beside[2], result=result)
        shown = self._drawn.get_or_make(key, lambda: _drawn(slot, result, results, translation, session))
        if truths is not None or other is not None:
            shown = _with_others(slot, shown, results, translation, session, other, truths)
            self._beside.put(key, (other, truths, shown))
        return replace(shown, result=result)


def _drawn(
    stage: Stage, result: StageResult, results: Mapping[str, StageResult], translation: Translation, session: Session
) -> StagePreview:
    seen = _seen(results, translation, session)
    picture = stage.make_preview(result.output, seen)
    layers = stage.make_layers(result.output, seen, picture)
    kept = stage.split_steps(result.output)
    states = tuple(stage.make_preview(state, seen) for state in kept)
    solid = tuple(stage.make_step_layers(state, seen, drawn) for state, drawn in zip(kept, states, strict=True))
    way = stage.summarise_steps(result.output)
    return StagePreview(
        result=result, preview=picture, layers=layers, step_previews=states, step_layers=solid, step_history=way
    )


def _weight(shown: StagePreview) -> int:
    """Its result is the graph's to weigh."""
    return measure_bytes(
        (shown.preview, shown.layers, shown.truth_view, shown.step_previews, shown.step_layers), shown.result.output
    )


def _with_others(
    stage: Stage,
    shown: StagePreview,
    results: Mapping[str, StageResult],
    translation: Translation,
    session: Session,
    other: TargetComparison | None,
    truths: Mapping[str, object] | None,
) -> StagePreview:
    """With what the target felt itself, where that is compared, else with the truth."""
    if other is not None and other.paired_touch is not None:
        felt = build_observation_view(shown.preview, other.paired_touch.target, translation.target, session.display)
        return replace(shown, preview=add_observed_outline(shown.preview, other.observed_outline_px), truth_view=felt)
    if truths is None:
        return shown
    return replace(shown, truth_view=beside_truth(stage, shown.preview, truths, _seen(results, translation, session)))


def _seen(results: Mapping[str, StageResult], translation: Translation, session: Session) -> PreviewContext:
    return PreviewContext(
        outputs={name: r.output for name, r in results.items()}, source=translation.source,
        target=translation.target, mesh=translation.mesh, display=session.display,
    )  # fmt: skip


def _reading(frame: TactileFrame, sensor: SensorSpec, display: DisplayParams) -> tuple[Preview, Layer]:
    camera = match_camera(frame.camera or sensor.camera, frame.image.shape)
    picture = make_frame_preview(frame.image, camera, sensor, display, reference=frame.reference)
    return picture, make_frame_layer("source", frame.image, camera, picture.pixels, sensor)


def summarise_frame(
    results: Mapping[str, StageResult], metrics: Mapping[str, float], translation: Translation
) -> FrameSummary | None:
    """What the table of frames says of one; None without a depth."""
    depth = results["depth"].output if "depth" in results else None
    if not isinstance(depth, DepthMap):
        return None
    inside = depth.indentation_mm[depth.contact]
    inside = inside[np.isfinite(inside)]
    pixel_mm = float(np.median(translation.source.rest_depth_mm)) / depth.camera.fx_px
    return FrameSummary(
        max_indentation_mm=float(inside.max()) if inside.size else 0.0,
        contact_area_mm2=float(depth.contact.sum()) * pixel_mm**2,
        metrics=metrics,
        warnings=tuple(
            f"{translation.catalogue.stage(name).title.lower()}: {doubt}"
            for name, result in results.items()
            for doubt in result.warnings
        ),
    )
