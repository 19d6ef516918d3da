"""Exports, repro bundles, and what is on screen as a command line.

Written in the background, from their own files.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from PyQt6.QtCore import QPoint, Qt, QUrl
from PyQt6.QtGui import QDesktopServices
from PyQt6.QtWidgets import QInputDialog, QMenu

from app.compare.comparison import ComparisonController
from app.document.autosave import AutosaveController
from app.document.background_controller import BackgroundController
from app.document.requests import make_request
from app.document.session_controller import SessionController
from app.window import dialogs
from app.window.jobs import JobFunction
from pipeline.core.errors import TouchError, escape_text
from pipeline.translation.reports.export_request import (
    PRESENTATION,
    SCENE,
    SHEET,
    SOURCE,
    ExportRequest,
    PaneContent,
    format_command,
    format_settings,
)
from widgets.export.export_dialog import ExportDialog
from widgets.style.notification_bar import Choice, NotificationBar
from widgets.style.styling import copy_text

if TYPE_CHECKING:
    from pipeline.translation.reports.export import ExportOutcome

# title of what shows more than a stage
_WHOLE_PANES = {
    SHEET: "all, side by side",
    SCENE: "both sensors and the object, 3D",
    PRESENTATION: "presentation: source, 3D, touches",
}
_NOT_OPEN = "Nothing to export. Open a recording first."
_BUSY = "An export is already running. Wait for it, or cancel it."


class ExportController(BackgroundController):
    """Connects the export commands with the exports of the pipeline."""

    def __init__(
        self,
        controller: SessionController,
        autosave: AutosaveController,
        comparison: ComparisonController,
    ) -> None:
        self.notification = NotificationBar("export_notification")
        super().__init__("export", controller, self.notification.run_bar)
        self._autosave = autosave
        self._comparison = comparison
        self.dialog = ExportDialog(self._window)
        self._window.add_notification(self.notification)
        # see `start_writing`
        self._written: tuple[Path, str, Callable[[Any], str] | None] = Path(), "", None
        self._window.connect_command("export", self.show_export_dialog)
        self._window.connect_command(
            "save_video", partial(self.show_export_dialog, PRESENTATION, ".webm")
        )
        self._window.connect_command("export_scene", partial(self.show_export_dialog, SCENE))
        self._window.connect_command("copy_command", self.copy_view_command)
        self._window.section_panel.command.clicked.connect(self.copy_section_command)
        self._window.connect_command("export_bundle", self.ask_bundle)
        self.dialog.export_requested.connect(self._export_selected)
        self.dialog.command_requested.connect(self.copy_export_command)
        for name, column in self._columns.items():
            column.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
            column.customContextMenuRequested.connect(partial(self._show_menu, name))

    def make_export_request(
        self,
        path: Path,
        pane: str = SHEET,
        content: str = "computed",
        frames: str = "",
        size: tuple[int, int] | None = None,
    ) -> ExportRequest:
        """Build the export of what is on screen to one file."""
        session = self._session
        opened = self._translation
        assert opened is not None
        params = session.collect_params(opened.methods) | {"display": session.display}
        return ExportRequest(
            request=replace(make_request(session), offsets=session.offsets),
            pane=pane,
            content=cast("PaneContent", content),
            settings=format_settings(params),
            frame=session.frame,
            frames=frames,
            size_px=size,
            path=path,
        )

    def _check_open(self) -> bool:
        """Return whether there is something to export; says so if not."""
        if self._translation is None:
            self.notification.show_notification(_NOT_OPEN)
        return self._translation is not None

    def start_export(self, request: ExportRequest) -> None:
        """Write a file in the background."""
        from pipeline.translation.reports.export import export_file

        def describe(outcome: ExportOutcome) -> str:
            problems = outcome.problems
            left_out = f"; {len(problems)} left out: {problems[0]}" if problems else ""
            return f"written: {escape_text(str(request.path))}{left_out}"

        self.start_writing(
            f"writing {escape_text(request.path.name)}",
            partial(export_file, request),
            request.path,
            format_command(request),
            describe,
        )

    def start_bundle(self, folder: Path, note: str) -> None:
        """Write a repro bundle of the frame on screen in the background."""
        from pipeline.translation.reports.repro_bundle import write_bundle

        of = self.make_export_request(folder)
        self.start_writing(
            "writing the repro bundle",
            lambda report: write_bundle(
                of.request, of.settings, of.frame, folder, note=note, progress=report
            ),
            folder,
            f"tactoscope replay {dialogs.quote_path(folder)}",
        )

    def copy_export_command(
        self,
        pane: str,
        content: str = "",
        suffix: str = ".png",
        frames: str = "",
        size: tuple[int, int] | None = None,
    ) -> None:
        """Copy the command that writes this export."""
        if not self._check_open():
            return
        content = content or self._content_on_screen(pane)
        path = Path(f"{pane}{suffix}")
        self._copy(format_command(self.make_export_request(path, pane, content, frames, size)))

    def copy_view_command(self) -> None:
        """Copy the command that reproduces the screen: all tiles or cells of Compare, else the
        panes.
        """
        opened = self._translation
        if self._session.layout.name != "compare" or opened is None:
            self.copy_export_command(self._pane_on_screen())
            return
        try:
            self._copy(self._comparison.format_command(opened, Path("compared")))
        except TouchError as error:
            self.notification.show_notification(str(error))

    def copy_section_command(self) -> None:
        """Copy the command that writes the curves of the section."""
        line = self._controller.section
        if line is None or self._translation is None:
            return
        shown = self._window.visible_columns()
        pane = SHEET if set(shown) == set(self._window.route_columns) else ",".join(shown)
        request = self.make_export_request(Path("section.csv"), pane)
        self._copy(format_command(replace(request, section=tuple(line.plain))))

    def _copy(self, command: str) -> None:
        copy_text(command)
        self.notification.show_notification(f"copied: {command}")

    def show_export_dialog(self, pane: str = "", suffix: str = ".png") -> None:
        """Ask what to export."""
        opened = self._translation
        if opened is None:
            self.notification.show_notification(_NOT_OPEN)
            return
        stages = [(name, opened.catalogue.stage(name).title.lower()) for name in opened.stages]
        panes = [*_WHOLE_PANES.items(), (SOURCE, "source"), *stages]
        pane = pane or self._pane_on_screen()
        self.dialog.show_panes(panes, pane, self._content_on_screen(pane), suffix)
        self.dialog.show()
        self.dialog.raise_()

    def ask_bundle(self) -> None:
        """Ask for a note and a folder, then write the repro bundle."""
        if not self._check_open():
            return
        note, accepted = QInputDialog.getText(self._window, "Export repro bundle", "What it shows")
        if accepted and (folder := self.ask_save_path("export_bundle")):
            self.start_bundle(folder, note)

    def ask_save_path(self, command: str) -> Path | None:
        """Ask where a command writes to; None if cancelled."""
        return dialogs.ask_save_path(self._window, command, self._autosave.dialog_folder)

    def _export_selected(
        self, pane: str, content: str, suffix: str, frames: str, size: tuple[int, int] | None
    ) -> None:
        path = self.ask_path("Export", suffix)
        if path is not None:
            self.start_export(self.make_export_request(path, pane, content, frames, size))

    def ask_path(self, title: str, suffix: str) -> Path | None:
        """Ask for a file to write; None if nothing is open or the user cancels."""
        if not self._check_open():
            return None
        path = dialogs.ask_export_path(self._window, title, suffix, self._autosave.dialog_folder)
        if path is not None:
            self._autosave.preferences.last_folder = path.parent
        return path

    def start_writing(
        self,
        text: str,
        work: JobFunction,
        path: Path,
        command: str = "",
        describe: Callable[[Any], str] | None = None,
    ) -> None:
        """Write something in the background, unless an export is running.

        `command` writes the same, `describe` turns the result into a sentence.
        """
        if self.job.is_busy:
            self.notification.show_notification(_BUSY)
            return
        if not self._check_open():
            return
        self.notification.show_notification(f"{text}…", stays=True)
        self._written = path, command, describe
        self.start(work)

    def show_result(self, result: object) -> None:
        """Offer the folder and the command of the written file."""
        path, command, describe = self._written
        folder = QUrl.fromLocalFile(str(path.parent))
        choices: list[Choice] = [("Show folder", partial(QDesktopServices.openUrl, folder))]
        if command:
            choices.insert(0, ("Copy as command", partial(copy_text, command)))
        text = f"written: {escape_text(str(path))}" if describe is None else describe(result)
        self.notification.show_notification(text, choices)

    def show_failure(self, error: BaseException) -> None:  # noqa: ARG002 - the banner shows it
        """Leave the place to the banner."""
        self.notification.hide()

    def show_cancelled(self) -> None:
        """Show that no file was written."""
        self.notification.show_notification("cancelled; nothing was written")

    def _pane_on_screen(self) -> str:
        """The stage in the active pane; all side by side where there are no panes."""
        look = self._window.look
        return (look.active_stage if look.isVisible() else "") or SHEET

    def _content_on_screen(self, pane: str) -> str:
        mode = self._views.comparison_mode
        is_whole = pane in (*_WHOLE_PANES, SOURCE)
        return mode if mode in ("truth", "difference") and not is_whole else "computed"

    def _show_menu(self, name: str, at: QPoint) -> None:
        menu = QMenu(self._window)
        menu.addAction("Export pane…", lambda: self.show_export_dialog(name))
        menu.addAction("Copy as command", lambda: self.copy_export_command(name))
        menu.addAction("Export repro bundle…", self.ask_bundle)
        menu.popup(self._columns[name].mapToGlobal(at))
