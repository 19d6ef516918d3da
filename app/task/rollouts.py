"""The *Task* layout: opens rollouts, and shows one tick of the current one in scene, plot and
touches.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from PyQt6.QtCore import pyqtSignal

from app.document.background_controller import BackgroundController
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.task.rollout_jobs import OpenRollout, TrialFolder, list_trial_folder, open_rollout
from app.views.stage_previews import SourcePreview, StagePreview
from app.window import dialogs
from app.window.jobs import JobReporter
from pipeline.core.errors import TouchError
from pipeline.io.mounts import is_mounted
from pipeline.lab.tasks.scene_view import (
    ESTIMATE_COLOUR,
    ESTIMATE_NAME,
    OBJECT_COLOUR,
    describe_tick,
)
from pipeline.lab.tasks.trial_rows import SUFFIXES, TrialRow

_COMMANDS = (
    "export_rollout_video",
    "copy_trials",
    "next_trial",
    "previous_trial",
    "next_decision",
)
_NOTHING = (
    "Open the rollouts of a task to see which trials fail, and which error of the touch makes them "
    "fail."
)
_NOT_READ = {
    "true": "not read: the controller has the true touch",
    "none": "not read: the controller acts as planned",
}


class RolloutController(BackgroundController):
    """Connects the page with the session; nothing is read while another layout is shown."""

    shows_errors = True
    rollout_shown = pyqtSignal()  # another rollout, or none
    decision_shown = pyqtSignal(int)  # the decision that acts at the tick on screen

    def __init__(self, controller: SessionController, export: ExportController) -> None:
        super().__init__("rollouts", controller)
        self._page = self._window.task
        self._export = export
        self.folder: TrialFolder | None = None
        self.shown: OpenRollout | None = None
        self._requested: Path | None = None  # rollout that is read or shown
        # that the user opened: a folder, or a recording that may be a rollout
        self._opening: Path | None = None
        page = self._page
        window = self._window
        page.trials.trial_chosen.connect(self.choose_trial)
        page.place_box.chosen.connect(self._choose_place)
        page.ticks.frame_chosen.connect(controller.set_tick)
        page.plot.step_chosen.connect(controller.set_tick)
        controller.tick_changed.connect(self._show_tick)
        controller.rollouts_requested.connect(self.open_rollouts)
        controller.recording_opened.connect(self._check_recording)
        controller.job.delivered.connect(self._show_touch)
        window.connect_command("next_trial", lambda: page.trials.step_by(1))
        window.connect_command("previous_trial", lambda: page.trials.step_by(-1))
        window.connect_command("copy_trials", page.trials.copy_rows)
        window.connect_command("next_decision", self._go_to_next_decision)
        window.connect_command("export_rollout_video", self._ask_video)
        page.show_message(_NOTHING)
        page.split.hide()
        self._show_opened(None)

    def open_rollouts(self, path: Path) -> None:
        """Open a folder of rollouts, or one of them; a folder without any opens as a recording."""
        # what is being read is dropped
        self._opening = path
        self._requested = None
        self.start(partial(list_trial_folder, path))

    def choose_trial(self, path: Path) -> None:
        """Open one of the listed rollouts."""
        folder = self.folder
        for row in () if folder is None else folder.trials:
            if row.path == path and row.problem:
                self._page.show_message(row.problem)
        if folder is not None and path in folder.choices:
            self._controller.set_tick(0)
            layout = replace(self._session.layout, name="task")
            self._controller.open_trial(path, folder.choices[path], layout)

    def _choose_place(self, stream: str) -> None:
        self._change("choose finger", stream=stream)

    @property
    def decision(self) -> int:
        """Index of the decision that acts at the tick on screen."""
        return 0 if self.shown is None else self.shown.rollout.find_decision(self._tick)

    @property
    def _tick(self) -> int:
        last = 0 if self.shown is None else self.shown.rollout.n_ticks - 1
        return min(self._controller.tick, last)

    def _check_recording(self, path: Path) -> None:
        if path.suffix.lower() in SUFFIXES and not is_mounted(path):
            self.open_rollouts(path)

    def show_session(self) -> None:
        """Read the rollout that the session has open while its layout is *Task*."""
        session = self._session
        if session.layout.name != "task":
            self._page.ticks.play(on=False)
            if self._opening is None:
                self.abandon()
                self._requested = None if self.shown is None else self.shown.rollout.path
            return
        path = session.recording
        if path is not None and path != self._requested and not is_mounted(path):
            self._requested = path
            self._opening = None
            needs_folder = self.folder is None or self.folder.folder != path.parent
            self.start(partial(_read_rollout, path, needs_folder=needs_folder))
        elif self.shown is not None and path == self.shown.rollout.path:
            self._page.offer_places(self.shown.places, session.stream)
            self._follow_frame(session.frame)

    def show_progress(self, fraction: float, text: str) -> None:
        """Show what is read."""
        self._page.show_message(f"{text}: {fraction:.0%}")

    def show_part(self, part: object) -> None:
        """Show the rows of a folder."""
        if isinstance(part, TrialFolder):
            self.folder = part
            self._page.split.show()
            self._window.offer_layout("task", offered=True)
            self._page.trials.show_trials(part.trials)

    def show_result(self, result: object) -> None:
        """Show a rollout, or open one of a folder."""
        self.show_part(result)
        if isinstance(result, OpenRollout):
            self._show_rollout(result)
        elif isinstance(result, TrialFolder):
            opening = self._opening
            self._opening = None
            chosen = opening if opening in result.choices else _choose_first(result.trials)
            if opening is not None and chosen is not None:
                self.choose_trial(chosen)

    def show_failure(self, error: BaseException) -> None:
        """Show why nothing can be shown, in one sentence."""
        opening = self._opening
        self._opening = None
        is_expected = opening is not None and isinstance(error, TouchError)
        if opening is not None and is_expected and opening.is_dir():
            self._controller.open_data(opening)
            return
        if is_expected and self._session.layout.name != "task":
            return
        self._requested = self._session.recording
        self._page.clear()
        self._page.show_message(str(error))
        self._views.show_page_scene("task", (), None, self._session)
        self._show_opened(None)

    def _show_opened(self, opened: OpenRollout | None) -> None:
        self.shown = opened
        for name in _COMMANDS:
            self._actions[name].setEnabled(opened is not None)
        self.rollout_shown.emit()

    def _show_rollout(self, opened: OpenRollout) -> None:
        page, session = self._page, self._session
        self.shown = opened
        run = opened.rollout
        decisions = [decision.tick for decision in run.summary.decisions]
        page.show_message(opened.unavailable)
        page.trials.show_trial(run.path)
        page.show_curves(opened.curves, run.time_s.tolist(), decisions)
        page.ticks.show_frames(run.n_ticks)
        page.offer_places(opened.places, session.stream)
        page.views["touch"].show_message(_NOT_READ.get(run.summary.touch, ""))
        page.show_legend(
            ESTIMATE_COLOUR,
            OBJECT_COLOUR,
            has_estimate=any(layer.name == ESTIMATE_NAME for layer in opened.layers),
        )
        self._views.show_page_scene("task", opened.layers, opened.bounds, session)
        self._show_tick()
        self._show_opened(opened)

    def _show_tick(self, _: int = 0) -> None:
        """Show one tick everywhere: scene, plot, slider, frames and decision."""
        opened, page, tick = self.shown, self._page, self._tick
        if opened is None:
            return
        page.plot.show_step(tick)
        page.ticks.show_frame(tick, float(opened.rollout.time_s[tick]))
        page.scene.legend.setText(describe_tick(opened.rollout, tick))
        self._views.move_task_bodies(opened.poses[tick])
        session, translation = self._session, self._translation
        if session.layout.name == "task" and session.recording == opened.rollout.path:
            n_frames = 1 if translation is None else translation.n_frames
            if self.decision != session.frame and self.decision < n_frames:
                self._controller.choose_frame(self.decision)
        self.decision_shown.emit(self.decision)

    def _follow_frame(self, frame: int) -> None:
        """Go to the tick of a decision whose frame was chosen by undo or in another layout."""
        decisions = () if self.shown is None else self.shown.rollout.summary.decisions
        if 0 <= frame < len(decisions) and frame != self.decision:
            self._controller.set_tick(decisions[frame].tick)

    def _go_to_next_decision(self) -> None:
        if self.shown is not None:
            ticks = [one.tick for one in self.shown.rollout.summary.decisions]
            later = [tick for tick in ticks if tick > self._tick]
            for tick in (later or ticks)[:1]:
                self._controller.set_tick(tick)

    def write_video(self, path: Path) -> None:
        """Write the rollout on screen as a video."""
        from pipeline.lab.tasks.rollout_video import write_rollout_video

        if self.shown is not None:
            source = self.shown.rollout.path
            self._export.start_writing(
                f"writing {path.name}",
                partial(write_rollout_video, source, path),
                path,
                f"tactoscope rollout video {dialogs.quote_path(source)} --out "
                f"{dialogs.quote_path(path)}",
            )

    def _ask_video(self) -> None:
        path = self._export.ask_path("Export rollout video", ".mp4")
        if path is not None:
            self.write_video(path)

    def _show_touch(self, _: int, part: object) -> None:
        """Show the touches of the frame on screen while the page is visible."""
        views = self._page.views
        if self._session.layout.name != "task":
            return
        if isinstance(part, SourcePreview):
            views["source"].show_preview(part.preview)
        elif isinstance(part, StagePreview) and part.result.name == "touch":
            views["touch"].show_preview(part.preview)
            truth = None if part.truth_view is None else part.truth_view.truth
            views["truth"].show_preview(truth)
            views["truth"].show_message("" if part.truth_view else "not recorded")


def _read_rollout(path: Path, report: JobReporter, *, needs_folder: bool) -> OpenRollout:
    """Read the rows of the folder, if they are not known, and the rollout."""
    if needs_folder:
        report.deliver(list_trial_folder(path, report))
    return open_rollout(path, report)


def _choose_first(trials: tuple[TrialRow, ...]) -> Path | None:
    """The first rollout that fails, else the first that can be read; None without one."""
    good = [trial for trial in trials if not trial.problem]
    first = min(good, key=lambda trial: trial.succeeds, default=None)
    return None if first is None else first.path
