"""From results to finished pictures and layers, each made once: who plays or goes back sees the very same again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from app.session.state import Session
from app.work.comparison import Comparison
from pipeline.base.memo import Memo, size_bytes
from pipeline.engine.graph import StageResult
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.layers import Layer, reading_layer
from pipeline.pictures.picture import Picture, beside, fitted, of_reading
from pipeline.scoring.beside import Beside, beside_felt
from pipeline.scoring.beside import beside as beside_truth
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.slot import Facts, Seen, Slot, Way
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap
from widgets.frames_model import FrameSummary

_DRAWN_BYTES = 72 * 1024 * 1024  # a dozen frames to a gel of 320 x 427, seven pictures each
_READ_BYTES = _BESIDE_BYTES = 40 * 1024 * 1024
_MOST_JUDGED = 512


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceShown:
    """The frame itself, before any method."""

    frame: TactileFrame
    facts: Facts  # what is known of it
    picture: Picture
    layers: tuple[Layer, ...]
    ms: float  # reading it


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotShown:
    """One slot's result, drawn."""

    result: StageResult
    picture: Picture
    layers: tuple[Layer, ...]
    beside: Beside | None = None  # where it was asked for and is known
    states: tuple[Picture, ...] = ()  # kept on the way to it, where they are pictures of their own,
    state_layers: tuple[tuple[Layer, ...], ...] = ()  # in 3D, each empty where it is not drawn,
    way: Way | None = None  # and what is told of them all


class Read(NamedTuple):
    """A frame as it was read and drawn, and what is known of it."""

    frame: TactileFrame
    facts: Facts
    picture: Picture
    layer: Layer
    display: DisplayParams  # that it was drawn with


class Drawing:
    """What was read, drawn and judged of one translation; used by one thread at a time."""

    def __init__(self, most_bytes: int = _DRAWN_BYTES) -> None:
        self._drawn: Memo[object, SlotShown] = Memo(most_bytes=most_bytes, weigh=_weight)
        # Beside a truth or what was felt: with those, since equal keys may stand beside others.
        self._beside: Memo[object, tuple[object, object, SlotShown]] = Memo(
            most_bytes=min(most_bytes, _BESIDE_BYTES), weigh=lambda kept: _weight(kept[2])
        )
        self._read: Memo[int, Read] = Memo(most_bytes=min(most_bytes, _READ_BYTES))
        self._judged: Memo[object, dict[str, float]] = Memo(_MOST_JUDGED)

    def frame(self, translation: Translation, index: int, display: DisplayParams) -> Read:
        """A frame with all that is known of it, kept: who plays or goes back asks for it again."""
        kept = self._read.get(index)
        if kept is None or (kept.frame.is_depth and kept.display != display):  # a gel's colours are its own
            frame = translation.stream.frame(translation.checked(index)) if kept is None else kept.frame
            facts = translation.facts(index) if kept is None else kept.facts
            kept = Read(frame, facts, *_reading(frame, translation.source, display), display)
            if translation.recording.now is None:  # one that grows may be set to zero anew, or forget its oldest
                self._read.put(index, kept)
        return kept

    def figures(
        self, translation: Translation, results: Mapping[str, StageResult], index: int, facts: Facts
    ) -> dict[str, float]:
        """The frame's figures; equal answers have equal ones, and are not judged again."""
        key = (index, *((name, result.digest) for name, result in results.items()))
        known = self._judged.get(key)
        if known is None:
            known = translation.figures(results, facts)
            self._judged.put(key, known)
        return known

    def draw(
        self,
        result: StageResult,
        results: Mapping[str, StageResult],
        translation: Translation,
        session: Session,
        other: Comparison | None,
        truths: Mapping[str, object] | None,
    ) -> SlotShown:
        """Pictures of an output that was drawn before are used again, so that the window need not touch them."""
        slot = translation.catalogue.slot(result.name)
        also = tuple(results[name].digest for name in slot.looks_at if name in results)
        n_kept = len(getattr(result.output, "steps", ()))  # which the digest does not count
        key = (result.name, result.digest, n_kept, session.display, also)
        beside = None if truths is None and other is None else self._beside.get(key)
        if beside is not None and beside[0] is other and beside[1] is truths:
            return replace(beside[2], result=result)
        shown = self._drawn.of(key, lambda: _drawn(slot, result, results, translation, session))
        if truths is not None or other is not None:
            shown = _with_others(slot, shown, results, translation, session, other, truths)
            self._beside.put(key, (other, truths, shown))
        return replace(shown, result=result)


def _drawn(
    slot: Slot, result: StageResult, results: Mapping[str, StageResult], translation: Translation, session: Session
) -> SlotShown:
    seen = _seen(results, translation, session)
    picture = slot.picture(result.output, seen)
    layers = slot.layers(result.output, seen, picture)
    kept = slot.states(result.output)
    states = tuple(slot.picture(state, seen) for state in kept)
    solid = tuple(slot.state_layers(state, seen, drawn) for state, drawn in zip(kept, states, strict=True))
    way = slot.way(result.output)
    return SlotShown(result=result, picture=picture, layers=layers, states=states, state_layers=solid, way=way)


def _weight(shown: SlotShown) -> int:
    """Its result is the graph's to weigh."""
    return size_bytes(
        (shown.picture, shown.layers, shown.beside, shown.states, shown.state_layers), shown.result.output
    )


def _with_others(
    slot: Slot,
    shown: SlotShown,
    results: Mapping[str, StageResult],
    translation: Translation,
    session: Session,
    other: Comparison | None,
    truths: Mapping[str, object] | None,
) -> SlotShown:
    """With what the target felt itself, where that is compared, else with the truth."""
    if other is not None and other.touch is not None:
        felt = beside_felt(shown.picture, other.touch.target, translation.target, session.display)
        return replace(shown, picture=beside(shown.picture, other.outline_px), beside=felt)
    if truths is None:
        return shown
    return replace(shown, beside=beside_truth(slot, shown.picture, truths, _seen(results, translation, session)))


def _seen(results: Mapping[str, StageResult], translation: Translation, session: Session) -> Seen:
    return Seen(
        outputs={name: r.output for name, r in results.items()}, source=translation.source,
        target=translation.target, mesh=translation.mesh, display=session.display,
    )  # fmt: skip


def _reading(frame: TactileFrame, sensor: SensorSpec, display: DisplayParams) -> tuple[Picture, Layer]:
    camera = fitted(frame.camera or sensor.camera, frame.image.shape)
    picture = of_reading(frame.image, camera, sensor, display, reference=frame.reference)
    return picture, reading_layer("source", frame.image, camera, picture.pixels, sensor)


def summary_of(
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
        deepest_mm=float(inside.max()) if inside.size else 0.0,
        contact_mm2=float(depth.contact.sum()) * pixel_mm**2,
        figures=metrics,
        doubts=tuple(
            f"{translation.catalogue.slot(name).title.lower()}: {doubt}"
            for name, result in results.items()
            for doubt in result.doubts
        ),
    )
