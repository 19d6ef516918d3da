"""Puts what the background hands over into the window: columns, 3D views, captions, timings."""

from __future__ import annotations

from collections.abc import Mapping

from app.frame.tracing import Tracer
from app.frame.window import Window
from app.session.state import Session
from app.work.work import FrameShown, Opened, SourceShown, StageShown
from pipeline.base.errors import TouchError
from pipeline.engine.graph import StageResult
from pipeline.translation.routes import STAGES
from pipeline.values.results import ObjectPose, PoseStep
from widgets.colours import AXES
from widgets.layers import EmptyScene, Layer, Scene
from widgets.picture import Picture
from widgets.timings_panel import TimingRow

TIMES = "\N{MULTIPLICATION SIGN}"
_AXES = " ".join(f"<b style='color:rgb{colour}'>{name}</b>" for name, colour in zip("xyz", AXES, strict=True))
_OF_ALIGNMENT = ("adapt", "project", "generate", "pose")  # columns that an alignment changes
_LEGENDS = {
    "source": "reading on its surface",
    "depth": "membrane",
    "adapt": "points, target at rest",
    "project": "what the target sees",
    "generate": "target's membrane",
}


class Screen:
    """Knows which columns are fresh; everything here runs on the window's thread and takes finished values."""

    def __init__(self, window: Window, tracer: Tracer) -> None:
        self._window, self._tracer = window, tracer
        self._scene: Scene = EmptyScene()
        self._opened: Opened | None = None
        self._results: Mapping[str, StageResult] = {}
        self._layers: dict[int, tuple[Layer, ...]] = {}
        self._fresh: set[str] = set()
        self._order = tuple(window.columns)

    @property
    def opened(self) -> Opened | None:
        """The recording on screen."""
        return self._opened

    @property
    def scene(self) -> Scene:
        """The 3D views."""
        return self._scene

    def take_scene(self, scene: Scene, session: Session) -> None:
        """Take up the 3D views, which come after the window is on screen."""
        self._scene = scene
        self._window.scene_place.addWidget(scene.widget())
        self.look(session)
        for column, layers in self._layers.items():
            scene.show_layers(column, layers)

    def finish(self) -> None:
        """Let go of everything OpenGL."""
        self._scene.finish()

    def show_opened(self, opened: Opened) -> None:
        """Another recording, or the same one between other sensors."""
        old, self._opened = self._opened, opened
        t, window = opened.translation, self._window
        window.setWindowTitle(f"{t.request.recording.name} · {t.source.title} → {t.target.title} · Tactoscope")
        window.timeline.show_frames(t.n_frames)
        if old is None or old.translation.stream is not t.stream:
            window.frames.show_frames(t.n_frames)
        window.source.setItemText(0, f"as recorded: {t.source.name}")
        window.parameters.show_stages((*t.stages, "display"))
        window.banner.dismiss()
        self._results = {}
        self.look(opened.session)

    def show_part(self, part: SourceShown | StageShown) -> None:
        """One column's picture, layers and state."""
        name = part.result.name if isinstance(part, StageShown) else "source"
        column = self._window.columns[name]
        column.show_picture(part.picture)
        if isinstance(part, StageShown):
            self._results = {**self._results, name: part.result}
            column.show_state(part.result.state, part.result.ms, part.result.notes)
            self._tracer.show_cloud(part.cloud)
            self._tracer.show_results(self._results)
            if isinstance(part.result.output, ObjectPose):
                self._window.steps.show_steps(part.result.output.steps)
        else:
            self._results = {}  # those of another frame, or of other parameters
            column.show_state("read", part.ms)
            self._tracer.show_results(self._results, part.frame)
        index = self._order.index(name)
        self._layers[index] = part.layers
        self._scene.show_layers(index, part.layers)
        self._fresh.add(name)

    def show_preview(self, picture: Picture, layers: tuple[Layer, ...]) -> None:
        """The target's view of a drag on its way; what rests on it is out of date."""
        self._fresh -= set(_OF_ALIGNMENT)
        if self._results.keys() & set(_OF_ALIGNMENT):
            self._results = {name: r for name, r in self._results.items() if name not in _OF_ALIGNMENT}
            self._tracer.show_results(self._results)
        for name in _OF_ALIGNMENT:
            column = self._window.columns[name]
            if name != "project" and column.state != "stale":
                column.show_state("stale")
        column = self._window.columns["project"]
        column.show_picture(picture)
        column.show_state("preview")
        self._scene.show_layers(self._order.index("project"), layers)

    def show_frame(self, shown: FrameShown, *, comparable: bool) -> None:
        """Timings of a frame that is through, and its summary where that is `comparable` with those of the others."""
        if comparable and shown.summary is not None:
            self._window.frames.show_summary(shown.index, shown.summary)
            self._window.frames.show_frame(shown.index)
        done = [(stage, shown.results[stage.name]) for stage in STAGES if stage.name in shown.results]
        rows = [TimingRow(title=s.title, state=r.state, ms=r.ms, notes=r.notes) for s, r in done]
        self._window.timings.show_rows(tuple(rows))

    def expect_all(self) -> None:
        """Nothing on screen is fresh any more."""
        self._fresh = set()

    def mark_stale(self) -> None:
        """Dim what has not been replaced in time, and say where the work is."""
        for name in self._unfinished():
            self._window.columns[name].show_state("stale")
        self.mark_running()

    def mark_running(self) -> None:
        """The first column without a fresh result is the one being worked on."""
        waiting = self._unfinished()
        if waiting and self._window.columns[waiting[0]].state == "stale":
            self._window.columns[waiting[0]].show_state("running")

    def mark_failed(self, error: object) -> None:
        """The first column without a fresh result failed, those after it wait for it."""
        waiting = self._unfinished()
        for name in waiting:
            column = self._window.columns[name]
            text = str(error) if isinstance(error, TouchError) else "failed, see above"
            if name == waiting[0]:
                column.show_state("failed", None, (text,))
            else:
                column.show_state("waiting", None, (f"waits for {waiting[0]}",))

    def mark_cancelled(self) -> None:
        """What has not come will not come."""
        for name in self._unfinished():
            self._window.columns[name].show_state("waiting", None, ("cancelled",))

    def look(self, session: Session) -> None:
        """Set the cameras anew, and say which frame and stretch each 3D view has."""
        if self._opened is None:
            return
        t, display = self._opened.translation, session.display
        self._scene.look(self._opened.sights, linked=session.linked)
        radius = 0.04 * min(s.radius_mm for s in self._opened.sights.values())
        self._tracer.show_scene(self._scene, radius, display, t)
        for name, text in _LEGENDS.items():
            self._window.legends[name].setText(text)
        for name, caption in self._window.captions.items():
            place = t.source if name in ("source", "depth") else t.target
            times = 1.0 if name in ("source", "pose") else display.stretch(place)
            caption.setText(f"{place.name} frame {_AXES}" + ("" if times == 1.0 else f", depth {TIMES}{times:g}"))

    def show_step(self, step: PoseStep) -> None:
        """Put the object where it was at an iteration."""
        self._scene.place(self._order.index("pose"), "object", step.sensor_from_object)

    def show_only(self, name: str | None) -> None:
        """One stage alone, or all for None."""
        self._window.show_only(name)
        shown = self._window.visible_columns()
        self._scene.show_columns([i for i, n in enumerate(self._order) if n in shown])

    def _unfinished(self) -> list[str]:
        return [name for name in self._window.visible_columns() if name not in self._fresh]
