"""Exports, repro bundles, and what is on screen as a command line; written in the background, from their own files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

from PyQt6.QtCore import QPoint, Qt, QUrl
from PyQt6.QtGui import QDesktopServices, QGuiApplication
from PyQt6.QtWidgets import QInputDialog, QMenu

from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.background_controller import BackgroundController
from app.window.session_controller import SessionController
from app.window.sweep import SweepController
from app.work.jobs import JobFunction
from app.work.requests import make_request
from app.work.variants import format_compare_command
from pipeline.base.errors import TouchError
from pipeline.base.text import escape_text
from pipeline.reporting.export_request import SHEET, SOURCE, ExportRequest, PaneContent, format_command, format_settings
from widgets.export_dialog import ExportDialog
from widgets.notification_bar import NotificationBar

_NOT_OPEN = "Nothing to export. Open a recording first."
_NO_VARIANT = "No session B to compare with. Set B from the current settings or from another recording first."
_BUSY = "An export is already running. Wait for it, or cancel it."


class ExportController(BackgroundController):
    """Connects the export commands with the exports of the pipeline."""

    def __init__(self, controller: SessionController, autosave: AutosaveController, sweep: SweepController) -> None:
        super().__init__("export", controller)
        self._autosave, self._sweep, self._window = autosave, sweep, controller.window
        self.notification, self.dialog = NotificationBar("export_notification"), ExportDialog(self._window)
        self._window.notifications.add_bar(self.notification)
        self._written: tuple[Path, str] = Path(), ""  # what the running export writes, and its command
        self._window.connect_command("export", self.show_export_dialog)
        self._window.connect_command("copy_command", self.copy_view_command)
        self._window.section_panel.command_requested.connect(self.copy_section_command)
        self._window.connect_command("export_bundle", self.ask_bundle)
        self.dialog.export_requested.connect(self._ask_path)
        self.dialog.command_requested.connect(self.copy_export_command)
        for name, column in self._window.columns.items():
            column.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
            column.customContextMenuRequested.connect(partial(self._show_menu, name))

    def make_export_request(
        self, path: Path, pane: str = SHEET, content: str = "computed", frames: str = ""
    ) -> ExportRequest:
        """Build the export of what is on screen to one file."""
        session, opened = self._controller.session, self._controller.views.translation
        assert opened is not None
        params = {method.stage: session.get_params(method) for method in opened.methods}
        return ExportRequest(
            request=replace(make_request(session), offsets=session.offsets),
            pane=pane,
            content=cast("PaneContent", content),
            settings=format_settings({**params, "display": session.display}),
            frame=session.frame,
            frames=frames,
            path=path,
        )

    def start_export(self, request: ExportRequest) -> None:
        """Write a file in the background."""
        from pipeline.reporting.export import export_file

        if self._can_start():
            text = f"writing {escape_text(request.path.name)}"
            self._start(
                text, lambda report: export_file(request, report), request.path, format_command(request)
            )  # fmt: skip

    def start_bundle(self, folder: Path, note: str) -> None:
        """Write a repro bundle of the frame on screen in the background."""
        from pipeline.reporting.repro_bundle import write_bundle

        if not self._can_start():
            return
        request = self.make_export_request(folder)
        self._start(
            "writing the repro bundle",
            lambda report: write_bundle(
                request.request, request.settings, request.frame, folder, note=note, progress=report
            ),
            folder, f"tactoscope replay {dialogs.quote_path(folder)}",
        )  # fmt: skip

    def copy_export_command(self, pane: str, content: str = "", suffix: str = ".png", frames: str = "") -> None:
        """Copy the command that writes this export."""
        if self._controller.views.translation is None:
            self.notification.show_notification(_NOT_OPEN)
            return
        content = content or self._content_on_screen(pane)
        self._copy(format_command(self.make_export_request(Path(f"{pane}{suffix}"), pane, content, frames)))

    def copy_view_command(self) -> None:
        """Copy the command that reproduces the screen: all tiles of Compare, all cells of Sweep, else the panes."""
        session, opened = self._controller.session, self._controller.views.translation
        if session.layout.name not in ("compare", "sweep") or opened is None:
            self.copy_export_command(self._pane_on_screen())
        elif session.layout.name == "sweep":
            try:
                self._copy(self._sweep.format_command(opened.target.name, Path("swept")))
            except TouchError as error:
                self.notification.show_notification(str(error))
        elif session.comparison.tab == "two" and session.variant is None:
            self.notification.show_notification(_NO_VARIANT)
        else:
            self._copy(format_compare_command(session, opened.stages[-1], opened.target.name, Path("compared")))

    def copy_section_command(self) -> None:
        """Copy the command that writes the curves of the section."""
        line = self._controller.section
        if line is None or self._controller.views.translation is None:
            return
        shown = self._window.visible_columns()
        pane = SHEET if set(shown) == set(self._window.route_columns) else ",".join(shown)
        request = self.make_export_request(Path("section.csv"), pane)
        self._copy(format_command(replace(request, section=tuple(line.plain))))

    def _copy(self, command: str) -> None:
        _copy_text(command)
        self.notification.show_notification(f"copied: {command}")

    def show_export_dialog(self, pane: str = "") -> None:
        """Ask what to export."""
        opened = self._controller.views.translation
        if opened is None:
            self.notification.show_notification(_NOT_OPEN)
            return
        panes = [(SHEET, "all, side by side"), (SOURCE, "source")]
        panes += [(name, opened.catalogue.stage(name).title.lower()) for name in opened.stages]
        pane = pane or self._pane_on_screen()
        self.dialog.show_panes(panes, pane, self._content_on_screen(pane))
        self.dialog.show()
        self.dialog.raise_()

    def ask_bundle(self) -> None:
        """Ask for a note and a folder, then write the repro bundle."""
        if self._controller.views.translation is None:
            self.notification.show_notification(_NOT_OPEN)
            return
        note, accepted = QInputDialog.getText(self._window, "Export repro bundle", "What it shows")
        folder = (
            dialogs.ask_save_path(self._window, "export_bundle", self._autosave.dialog_folder) if accepted else None
        )
        if folder is not None:
            self.start_bundle(folder, note)

    def _ask_path(self, pane: str, content: str, suffix: str, frames: str) -> None:
        path = dialogs.ask_export_path(self._window, "Export", suffix, self._autosave.dialog_folder)
        if path is not None:
            self._autosave.preferences.last_folder = path.parent
            self.start_export(self.make_export_request(path, pane, content, frames))

    def _can_start(self) -> bool:
        if self._controller.views.translation is None or self.job.is_busy:
            self.notification.show_notification(_BUSY if self.job.is_busy else _NOT_OPEN)
            return False
        return True

    def start_writing(self, text: str, work: JobFunction, path: Path, command: str) -> None:
        """Write something in the background, unless an export is running."""
        if self._can_start():
            self._start(text, work, path, command)

    def _start(self, text: str, work: JobFunction, path: Path, command: str) -> None:
        self.notification.show_notification(f"{text}…", (("Cancel", self.cancel),), stays=True)
        self._written = path, command
        self.start(work)

    def show_progress(self, fraction: float, text: str) -> None:  # noqa: ARG002 - the bar has its own text
        """Show the progress in the notification."""
        self.notification.show_progress(fraction)

    def show_result(self, result: object) -> None:  # noqa: ARG002 - the file is the result
        """Offer the folder and the command of the written file."""
        path, command = self._written
        self.notification.show_notification(
            f"written: {escape_text(str(path))}",
            (
                ("Copy as command", lambda: _copy_text(command)),
                ("Show folder", lambda: QDesktopServices.openUrl(QUrl.fromLocalFile(str(path.parent)))),
            ),
        )

    def show_failure(self, error: BaseException) -> None:
        """Show the error in the banner."""
        self.notification.hide()
        self._controller.show_problem(error)

    def show_cancelled(self) -> None:
        """Show that no file was written."""
        self.notification.show_notification("cancelled; nothing was written")

    def _pane_on_screen(self) -> str:
        shown, layout = self._window.visible_columns(), self._controller.session.layout
        if layout.name == "inspect" and (panes := layout.resolve_panes(self._window.route_columns)):
            return panes[min(self._window.panes.active_pane, len(panes) - 1)][0]
        return shown[0] if len(shown) == 1 else SHEET

    def _content_on_screen(self, pane: str) -> str:
        mode = self._controller.views.comparison_mode
        return mode if pane not in (SHEET, SOURCE) and mode in ("truth", "difference") else "computed"

    def _show_menu(self, name: str, at: QPoint) -> None:
        column, menu = self._window.columns[name], QMenu(self._window)
        choices: tuple[tuple[str, Callable[[], None]], ...] = (
            ("Export pane…", lambda: self.show_export_dialog(name)),
            ("Copy as command", lambda: self.copy_export_command(name)),
            ("Export repro bundle…", self.ask_bundle),
        )
        for text, function in choices:
            action = menu.addAction(text)
            assert action is not None
            action.triggered.connect(function)
        menu.popup(column.mapToGlobal(at))


def _copy_text(text: str) -> None:
    clipboard = QGuiApplication.clipboard()
    if clipboard is not None:
        clipboard.setText(text)
