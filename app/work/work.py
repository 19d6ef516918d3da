"""Where the pipeline runs for the window: in the background thread, from a session to finished pictures and layers."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.session.state import DisplayParams, Session
from app.views import pictures, solids
from app.views.pictures import CloudPicture
from app.work.comparison import Comparison, Comparisons
from app.work.jobs import Report
from app.work.residuals import ObjectSurface
from pipeline.base.errors import FileProblem
from pipeline.engine.graph import Graph, StageResult
from pipeline.evaluation.metrics import frame_metrics
from pipeline.recordings import open_recording
from pipeline.stages.depth.stage import DepthParams
from pipeline.translation.translate import Request, Translation, new_graph, open_translation
from pipeline.values.frames import Recording, TactileFrame
from pipeline.values.results import DepthMap
from widgets.colours import coloured
from widgets.frames_panel import FrameSummary
from widgets.layers import Layer, Sight
from widgets.picture import Picture

log = logging.getLogger("tactoscope")


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A recording is open; `session` names what the user had left to it."""

    session: Session
    translation: Translation
    sights: Mapping[int, Sight]


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceShown:
    """The frame itself, before any stage."""

    frame: TactileFrame
    picture: Picture
    layers: tuple[Layer, ...]
    ms: float  # reading it


@dataclass(frozen=True, slots=True, kw_only=True)
class StageShown:
    """One stage's result, drawn."""

    result: StageResult
    picture: Picture
    layers: tuple[Layer, ...]
    cloud: CloudPicture | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameShown:
    """All wanted stages are through."""

    index: int
    settings: Session  # that it was worked out with
    frame: TactileFrame
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    summary: FrameSummary | None


class Bench:
    """Holds what is open and what was worked out; used by one thread at a time."""

    def __init__(self) -> None:
        self._graph: Graph = new_graph()
        self._request: Request | None = None
        self._translation: Translation | None = None
        self._surface: tuple[Any, ObjectSurface] | None = None
        self._drawn: dict[str, tuple[object, StageShown]] = {}
        self._comparisons = Comparisons()

    def show(self, session: Session, wanted: tuple[str, ...], report: Report, *, beside: bool = False) -> FrameShown:
        """Work out a session's frame, handing over every part as soon as it is done; raises TouchError.

        `beside` also outlines what the target really felt, where the recording holds it.
        """
        opened = self._opened(session, report)
        translation = replace(opened, alignment=session.offsets.applied(opened.alignment))
        index = min(session.frame, translation.n_frames - 1)
        started_s = time.perf_counter()
        inputs = translation.inputs(index)
        ms = 1e3 * (time.perf_counter() - started_s)
        frame = inputs["frame"]
        assert isinstance(frame, TactileFrame)
        picture = pictures.of_source(frame, translation.source)
        layers = solids.of_source(frame, picture.pixels, translation.source)
        report.hand_over(SourceShown(frame=frame, picture=picture, layers=layers, ms=ms))
        results: dict[str, StageResult] = {}

        def on_stage(result: StageResult) -> None:
            results[result.name] = result
            seen = result.name == "project" and beside
            other = self._compared(translation, index, results["depth"].output, session) if seen else None
            report.hand_over(self._draw(result, results, translation, session.display, other))

        stages = tuple(name for name in translation.stages if name in wanted)
        self._graph.evaluate(stages, inputs, session.params, report, on_stage)
        metrics = frame_metrics(
            results, translation.truth_of_source(index), translation.truth_of_target(index), translation.mesh,
            translation.symmetry,
        )  # fmt: skip
        return FrameShown(
            index=index, settings=replace(session, target=translation.target.name).settings, frame=frame,
            results=results, metrics=metrics, summary=_summary(results, metrics, translation),
        )  # fmt: skip

    def comparison(self, session: Session, report: Report) -> tuple[Translation, Comparison]:
        """The translation as it was opened, without offsets, and the session's frame on both sides.

        A drag asks for the same frame again and again: it is neither read nor looked up anew.
        """
        opened = self._opened(session, report)
        index = min(session.frame, opened.n_frames - 1)
        known = self._comparisons.known(index, _depth_params(session))
        if known is not None:
            return opened, known
        depth = self._graph.evaluate(("depth",), opened.inputs(index), session.params, report)["depth"]
        return opened, self._compared(opened, index, depth.output, session)

    def _compared(self, translation: Translation, index: int, depth: object, session: Session) -> Comparison:
        assert isinstance(depth, DepthMap)
        params = _depth_params(session)
        known = self._comparisons.known(index, params)
        return known or self._comparisons.of(translation, index, depth, params)

    def close(self) -> None:
        """Let go of the recording's file."""
        if self._translation is not None:
            self._translation.recording.close()
            self._translation = None

    def _opened(self, session: Session, report: Report) -> Translation:
        request = request_of(session)
        if self._translation is not None and request == self._request:
            return self._translation
        report.step(0.0, "opening the recording")
        if not request.target:
            request = replace(request, target=_best_target(request))
        translation = open_translation(request)
        if translation.n_frames == 0:
            translation.recording.close()
            raise FileProblem("the recording holds no frame; choose another", request.recording)
        if self._translation is not None:
            self._translation.recording.close()
        self._translation, self._drawn = translation, {}
        self._comparisons.forget()
        named = replace(
            session, target=translation.target.name, source=session.source, stream=session.stream,
            frame=min(session.frame, translation.n_frames - 1),
        )  # fmt: skip
        self._request = request_of(named)
        for note in translation.notes:
            log.info("%s", note)
        sights = solids.sights(translation.source, translation.target, translation.alignment)
        report.hand_over(Opened(session=named, translation=translation, sights=sights))
        return translation

    def _draw(
        self,
        result: StageResult,
        results: Mapping[str, StageResult],
        translation: Translation,
        display: DisplayParams,
        other: Comparison | None,
    ) -> StageShown:
        """Pictures of an output that was drawn before are used again, so that the window need not touch them."""
        key = (result.digest, display, results["generate"].digest if result.name == "pose" else "")
        key += (other and (other.index, id(other)),)
        known = self._drawn.get(result.name)
        if known is not None and known[0] == key:
            shown = replace(known[1], result=result)
        else:
            shown = self._drawing(result, results, translation, display)
            if other is not None and other.touch is not None:
                shown = replace(shown, picture=pictures.beside(shown.picture, other.outline_px))
        self._drawn[result.name] = (key, shown)
        return shown

    def _drawing(
        self, result: StageResult, results: Mapping[str, StageResult], translation: Translation, display: DisplayParams
    ) -> StageShown:
        output, source, target = result.output, translation.source, translation.target
        stretch = display.stretch(source if result.name == "depth" else target)
        cloud = None
        if result.name == "depth":
            picture = pictures.of_depth(output, source, display)
            layers = solids.of_depth(output, picture.pixels, stretch)
        elif result.name == "adapt":
            cloud = pictures.of_cloud(output, target, display)
            picture = cloud.picture
            reach = -target.membrane.signed_distance_mm(output.points_mm).astype(np.float32)
            assert picture.scale is not None
            layers = solids.of_cloud(output, target, coloured(reach, picture.scale), stretch)
        elif result.name == "project":
            picture = pictures.of_view(output, target, display)
            layers = solids.of_view(output, target, picture.pixels, stretch)
        elif result.name == "generate":
            picture = pictures.of_touch(output, target)
            layers = solids.of_touch(output, picture.pixels, stretch)
        else:
            touch = results["generate"].output
            picture = pictures.of_pose(output, touch, target, self._object_surface(translation))
            layers = solids.of_pose(output, translation.mesh, target)
        return StageShown(result=result, picture=picture, layers=layers, cloud=cloud)

    def _object_surface(self, translation: Translation) -> ObjectSurface | None:
        if translation.mesh is None:
            return None
        if self._surface is None or self._surface[0] is not translation.mesh:
            self._surface = (translation.mesh, ObjectSurface(translation.mesh))
        return self._surface[1]


def request_of(session: Session) -> Request:
    """What a session asks the pipeline to open."""
    assert session.recording is not None
    return Request(
        recording=session.recording, target=session.target, source=session.source, stream=session.stream,
        route=session.route, reference=session.reference, calibration=session.calibration, mesh=session.mesh,
        mesh_unit=session.mesh_unit, alignment=session.alignment,
    )  # fmt: skip


def _depth_params(session: Session) -> DepthParams:
    params = session.params["depth"]
    assert isinstance(params, DepthParams)
    return params


def _best_target(request: Request) -> str:
    """The other sensor of the same recording, else one that differs from the source."""
    recording: Recording = open_recording(request.recording, sensor=request.source, reference=request.reference)
    try:
        source = recording.stream(request.stream or request.source).sensor
        others = [s.sensor for s in recording.streams if s.sensor not in ("", source)]
    finally:
        recording.close()
    if others:
        return others[0]
    return "soft_bubble" if source.startswith("gelslim") else "gelslim"


def _summary(
    results: Mapping[str, StageResult], metrics: Mapping[str, float], translation: Translation
) -> FrameSummary | None:
    depth = results["depth"].output if "depth" in results else None
    if not isinstance(depth, DepthMap):
        return None
    inside = depth.indentation_mm[depth.contact]
    inside = inside[np.isfinite(inside)]
    pixel_mm = float(np.median(translation.source.rest_depth_mm)) / depth.camera.fx_px
    return FrameSummary(
        deepest_mm=float(inside.max()) if inside.size else 0.0,
        contact_mm2=float(depth.contact.sum()) * pixel_mm**2,
        error_mm=metrics.get("generate.contact_mae_mm"),
    )
