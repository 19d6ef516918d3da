"""Puts what the background hands over into the window: columns, 3D views, captions, timings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from app.frame.cameras import Cameras
from app.frame.captions import show_captions
from app.frame.places import sights
from app.frame.tracing import Tracer
from app.frame.window import Window
from app.session.state import Session
from app.work.drawing import SlotShown, SourceShown
from app.work.evaluator import FrameShown
from pipeline.base.arrays import Doubles
from pipeline.base.errors import TouchError
from pipeline.engine.graph import StageResult
from pipeline.pictures.layers import Layer
from pipeline.pictures.picture import Picture
from pipeline.scoring.beside import Beside, Versus
from pipeline.translation.translate import Request, Translation
from widgets.layers import Scene
from widgets.picture import PictureView
from widgets.steps import Step
from widgets.timings_panel import TimingRow

_PREVIEWED = "view"  # the slot that a drag of the alignment shows on its way
_GENERATED = "touch"  # the slot whose truth demonstrations show


class Screen:
    """Knows which columns are fresh; everything here runs on the window's thread and takes finished values."""

    def __init__(self, window: Window, tracer: Tracer) -> None:
        self._window, self._tracer = window, tracer
        self.scene = Scene(window.solids)  # the 3D views
        self.cameras = Cameras(tuple(window.columns))
        self.opened: Translation | None = None  # the recording on screen
        self.versus: Versus = ""  # what is shown beside, or in place of, what was worked out
        self._layers: dict[int, tuple[Layer, ...]] = {}
        self._states: dict[str, SlotShown] = {}  # slot -> what holds those kept on the way to its value
        self._fresh: set[str] = set()
        self._order = tuple(window.columns)
        self._results: Mapping[str, StageResult] = {}  # on screen
        self._others: tuple[tuple[str, Translation | None], ...] = ()  # a slot of other sessions, and what they opened
        self._parts: dict[str, SourceShown | SlotShown] = {}

    def take_scene(self, scene: Scene, session: Session) -> None:
        """Take up the 3D views, which come after the window is on screen."""
        self.scene = scene
        self.look(session)
        self.cameras.turn(scene if self.opened is not None else None)
        for column, layers in self._layers.items():
            scene.show_layers(column, layers)

    def finish(self) -> None:
        """Let go of everything OpenGL."""
        self.scene.finish()

    def show_opened(self, t: Translation, session: Session) -> None:
        """Another recording, or the same one between other sensors."""
        (old, self.opened), window = (self.opened, t), self._window
        window.setWindowTitle(f"{t.request.recording.name}[*] · {t.source.title} → {t.target.title} · Tactoscope")
        window.timeline.show_frames(t.n_frames)
        if old is None or old.stream is not t.stream:
            window.frames.known.show_frames(t.n_frames)
        window.warning.show_doubts(())
        self.scene.forget()  # what was drawn of the last one is drawn anew if it comes again
        window.source.setItemText(0, f"as recorded: {t.source.name}")
        window.leave_out(frozenset(slot.name for slot in t.catalogue.slots) - set(t.slots))
        window.banner.hide()
        self.look(session)
        self.cameras.turn(self.scene)

    def show_part(self, part: SourceShown | SlotShown, *, newest: bool = True) -> None:
        """One column's picture, layers and state; one that is not of the `newest` request leaves it waiting."""
        name = part.result.name if isinstance(part, SlotShown) else "source"
        column = self._window.columns[name]
        self._show_picture(column.view, part.picture, part.beside if isinstance(part, SlotShown) else None)
        self._window.panes.filmstrip.thumbnails[name].show_picture(column.view.picture or part.picture)
        if isinstance(part, SlotShown):
            if name == _GENERATED:
                self._show_truth(part)
            self._results = {**self._results, name: part.result}
            column.show_result(
                "draft" if part.result.draft else part.result.state,
                part.result.ms,
                part.result.notes,
                part.result.doubts,
                part.result.instead,
            )
            self._tracer.show_results(self._results)
            if name in self._window.steps:
                self._states[name] = part
                self._window.steps[name].show_steps(part.result.output.steps)
        else:
            self._results = {}  # those of another frame, or of other parameters
            column.show_state("read", part.ms)
            self._tracer.show_results(self._results, part.frame, part.facts)
        self._tell_state(name)
        column.view.canvas.prepare()
        index = self._order.index(name)
        self._layers[index] = part.layers
        self.scene.show_layers(index, part.layers)
        if newest:
            self._fresh.add(name)
        self._parts[name] = part

    def shown(self, name: str) -> SourceShown | SlotShown | None:
        """What a column shows, with all that may be shown beside it."""
        return self._parts.get(name)

    def _show_picture(self, view: PictureView, picture: Picture, other: Beside | None) -> None:
        """A picture, its truth, their difference, or both in one place, where that is asked for and known."""
        if other is not None and self.versus == "truth":
            picture = other.truth
        elif other is not None and self.versus == "difference" and other.gap is not None:
            picture = other.gap
        view.show_picture(picture)
        if other is not None and self.versus == "wipe":
            view.overlay.show_wiped(other.truth)
        elif other is not None and self.versus == "blink":
            view.overlay.show_blinking(other.truth)
        else:
            view.overlay.show_none()

    def _show_truth(self, part: SlotShown) -> None:
        """The truth of the generated touch in a column of its own, which demonstrations show."""
        column, other = self._window.truth, part.beside
        if column.isHidden():
            return
        if other is None:
            column.show_state("skipped", None, ("the recording does not hold what the target really felt",))
            return
        column.view.show_picture(other.truth)
        column.show_state("read")
        self.scene.show_layers(len(self._order), other.layers)

    def _tell_state(self, name: str) -> None:
        """The filmstrip's sign."""
        column = self._window.columns[name]
        self._window.panes.filmstrip.thumbnails[name].show_state(column.state, column.doubts)

    def show_wiped(self, before: Picture, after: Picture) -> None:
        """Two pictures of the target's view, the second right of the handle, until its part comes again."""
        view = self._window.columns[_PREVIEWED].view
        view.show_picture(before)
        view.overlay.show_wiped(after)

    def show_preview(self, picture: Picture, other: Beside | None, layers: tuple[Layer, ...]) -> None:
        """The target's view of a drag on its way; what rests on it is out of date."""
        changed = self._resting_on("alignment")
        self._fresh -= changed
        if self._results.keys() & changed:
            self._results = {name: r for name, r in self._results.items() if name not in changed}
            self._tracer.show_results(self._results)
        for name in changed - {_PREVIEWED}:
            column = self._window.columns[name]
            if column.state != "stale":
                column.show_state("stale")
        column = self._window.columns[_PREVIEWED]
        self._show_picture(column.view, picture, other)
        column.show_state("preview")
        self.scene.show_layers(self._order.index(_PREVIEWED), layers)

    def show_frame(self, shown: FrameShown, *, comparable: bool) -> None:
        """Timings of a frame that is through, and its summary where that is `comparable` with those of the others."""
        if comparable and shown.summary is not None:
            self._window.frames.known.show_summary(shown.index, shown.summary)
            self._window.frames.show_frame(shown.index)
        if self.opened is not None:
            slot = self.opened.catalogue.slot
            common = self._window.frames.known.common_doubts
            here = [(slot(key).title, doubt) for key, r in shown.results.items() for doubt in r.doubts]
            # What is doubted of every frame comes last: it is no news.
            here.sort(key=lambda pair: f"{pair[0].lower()}: {pair[1]}" in common)
            self._window.warning.show_doubts(here)
            rows = [
                TimingRow(title=slot(r.name).title, state=r.state, ms=r.ms, notes=r.notes)
                for r in shown.results.values()
            ]
            self._window.timings.show_rows(tuple(rows))

    def expect_all(self) -> None:
        """Nothing on screen is fresh any more."""
        self._fresh = set()

    def mark_stale(self) -> None:
        """Dim what has not been replaced in time, and say where the work is."""
        for name in self._unfinished():
            self._window.columns[name].show_state("stale")
            self._tell_state(name)
        self.mark_running()

    def mark_running(self) -> None:
        """The first column without a fresh result is the one being worked on."""
        waiting = self._unfinished()
        if waiting and self._window.columns[waiting[0]].state == "stale":
            self._window.columns[waiting[0]].show_state("running")
            self._tell_state(waiting[0])

    def mark_dropped(self) -> None:
        """Nothing is being worked on for now: what said so is only old."""
        for name in self._unfinished():
            if self._window.columns[name].state == "running":
                self._window.columns[name].show_state("stale")
                self._tell_state(name)

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
            self._tell_state(name)

    def mark_cancelled(self) -> None:
        """What has not come will not come."""
        for name in self._unfinished():
            self._window.columns[name].show_state("waiting", None, ("cancelled",))
            self._tell_state(name)

    def look(self, session: Session) -> None:
        """Set the cameras anew, and say what each 3D view shows."""
        if self.opened is None:
            return
        t, display = self.opened, session.display
        seen = sights(t)
        places = {self._order.index(name): sight for name, sight in seen.items()}
        if _GENERATED in seen:
            places[len(self._order)] = seen[_GENERATED]
        for k, (slot, other) in enumerate(self._others):
            if slot in seen and other is not None:
                places[len(self._order) + 1 + k] = sights(other)[slot]
        self.scene.look(places, linked=session.linked)
        self._tracer.show_scene(self.scene, display, t)
        self.caption(session)

    def caption(self, session: Session) -> None:
        """Say which frame and stretch each 3D view has, its axes in the colours that are on."""
        if self.opened is not None:
            show_captions(self._window, self.opened, session.display)

    def show_others(
        self, slot: str, others: Sequence[tuple[tuple[Layer, ...], Translation | None]], session: Session
    ) -> None:
        """A slot of other sessions, in 3D views of their own, which look from where the columns do."""
        old, self._others = self._others, tuple((slot, other) for _, other in others)
        if [_opened_as(*pair) for pair in old] != [_opened_as(*pair) for pair in self._others]:
            self.look(session)
        for k, (layers, _) in enumerate(others):
            self.scene.show_layers(len(self._order) + 1 + k, layers)
            self._layers[len(self._order) + 1 + k] = layers

    def show_step(self, slot: str, _step: Step, at: int) -> None:
        """Show a state's picture, and its layers where it has some."""
        kept = self._states.get(slot)
        if kept is None or at >= len(kept.states):
            return
        self._window.columns[slot].view.show_picture(kept.states[at])
        if kept.state_layers[at]:
            self.scene.show_layers(self._order.index(slot), kept.state_layers[at])

    def show_pose(self, sensor_from_object: Doubles, picture: Picture | None) -> None:
        """Put the object elsewhere, with the picture that goes with it, until the slot is filled anew."""
        self.scene.place(self._order.index("pose"), "object", sensor_from_object)
        if picture is not None:
            self._window.columns["pose"].view.show_picture(picture)

    def show_only(self, name: str | None) -> None:
        """One slot alone, or all of the route for None."""
        self._window.show_only(name)

    def _resting_on(self, name: str) -> set[str]:
        """The slots that change with an input."""
        changed = {name}
        for method in self.opened.methods if self.opened is not None else ():
            if changed.intersection(method.reads):
                changed.add(method.slot)
        return changed - {name}

    def _unfinished(self) -> list[str]:
        return [name for name in self._window.visible_columns() if name not in self._fresh]


def _opened_as(slot: str, other: Translation | None) -> tuple[str, Request | None]:
    """What a view of another session looks at: the same while its frames go by and its alignment is dragged."""
    return slot, None if other is None else other.request
