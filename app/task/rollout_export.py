"""Exports of the rollout on screen: video and repro bundle, written in the background from its
own file.
"""

from functools import partial
from pathlib import Path

from app.document.autosave import AutosaveController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.task.rollouts import RolloutController
from app.window import dialogs

_COMMANDS = (
    "export_rollout_video",
    "export_rollout_bundle",
    "copy_trials",
    "next_trial",
    "previous_trial",
    "next_decision",
)


class RolloutExportController(Feature):
    """Connects the export commands of the *Task* layout."""

    def __init__(
        self,
        controller: SessionController,
        rollouts: RolloutController,
        export: ExportController,
        autosave: AutosaveController,
    ) -> None:
        super().__init__(controller)
        self._rollouts = rollouts
        self._export = export
        self._window.connect_command("export_rollout_video", self._ask_video)
        autosave.connect_dialog("export_rollout_bundle", dialogs.ask_save_path, self.write_bundle)
        rollouts.rollout_shown.connect(self._enable)
        self._enable()

    def write_video(self, path: Path) -> None:
        """Write the rollout on screen as a video."""
        from pipeline.lab.tasks.rollout_video import write_rollout_video

        opened = self._rollouts.shown
        if opened is not None:
            source = opened.rollout.path
            command = (
                f"tactoscope rollout video {dialogs.quote_path(source)} --out "
                f"{dialogs.quote_path(path)}"
            )
            self._export.start_writing(
                f"writing {path.name}", partial(write_rollout_video, source, path), path, command
            )

    def write_bundle(self, folder: Path) -> None:
        """Write the rollout on screen as a repro bundle."""
        from pipeline.lab.tasks.rerun import write_rollout_bundle

        opened = self._rollouts.shown
        if opened is not None:
            source = opened.rollout.path
            command = f"tactoscope replay {dialogs.quote_path(folder)}"
            self._export.start_writing(
                "writing the rollout bundle",
                lambda _: write_rollout_bundle(source, folder),
                folder,
                command,
            )

    def _enable(self) -> None:
        for name in _COMMANDS:
            self._window.actions_by_name[name].setEnabled(self._rollouts.shown is not None)

    def _ask_video(self) -> None:
        path = self._export.ask_path("Export rollout video", ".mp4")
        if path is not None:
            self.write_video(path)
