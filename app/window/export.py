"""Handing on: exports, cases, and what is on screen as a command; all run beside the stages, on files of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

from PyQt6.QtCore import QObject, QPoint, Qt, QUrl
from PyQt6.QtGui import QDesktopServices, QGuiApplication
from PyQt6.QtWidgets import QInputDialog, QMenu

from app.window import dialogs
from app.window.autosave import AutosaveController
from app.window.session_controller import SessionController
from app.window.sweep import SweepController
from app.work.jobs import JobReporter, LatestJob
from app.work.requests import make_request
from app.work.variants import format_compare_command
from pipeline.base.errors import TouchError
from pipeline.base.text import escape_text
from pipeline.reporting.export_request import SHEET, SOURCE, ExportRequest, PaneContent, format_command, format_settings
from widgets.export_dialog import ExportDialog
from widgets.notification_bar import NotificationBar

_NOTHING = "nothing is open that could be exported; open a recording first"
_NO_B = "nothing is held as B yet; hold these settings, or choose another recording, and copy then"
_BUSY = "something is being written already; wait for it, or cancel it"


class ExportController(QObject):
    """Between the commands and the pipeline's exports."""

    def __init__(self, controller: SessionController, keeping: AutosaveController, sweeping: SweepController) -> None:
        super().__init__(controller)
        self._controller, self._keeping, self._window = controller, keeping, controller.window
        self._sweeping = sweeping
        self.notification, self.dialog = NotificationBar("export_notification"), ExportDialog(self._window)
        self._window.add_strip(self.notification)
        self.job = LatestJob("handing", self)
        self._then: Callable[[], None] = lambda: None
        self.job.progressed.connect(self._progressed)
        self.job.finished.connect(self._finished)
        self.job.cancelled.connect(self._cancelled)
        self.job.failed.connect(self._failed)
        controller.closing.connect(self.job.close)
        self._window.connect_command("export", self.show_export_dialog)
        self._window.connect_command("copy_command", self.copy_view_command)
        self._window.section_panel.command_requested.connect(self.copy_section_command)
        self._window.connect_command("export_bundle", self.ask_bundle)
        self.dialog.export_requested.connect(self._ask_where)
        self.dialog.command_requested.connect(self._copy_chosen)
        for name, column in self._window.columns.items():
            column.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
            column.customContextMenuRequested.connect(partial(self._menu, name))

    def make_export_request(
        self, path: Path, pane: str = SHEET, shown: str = "computed", frames: str = ""
    ) -> ExportRequest:
        """What is on screen, asked for as one file."""
        session, opened = self._controller.session, self._controller.views.translation
        assert opened is not None
        params = {method.stage: session.get_params(method) for method in opened.methods}
        return ExportRequest(
            request=replace(make_request(session), offsets=session.offsets),
            pane=pane,
            content=cast("PaneContent", shown),
            settings=format_settings({**params, "display": session.display}),
            frame=session.frame,
            frames=frames,
            path=path,
        )

    def start_export(self, asked: ExportRequest) -> None:
        """Write it in the background."""
        from pipeline.reporting.export import export_file

        if self._may():
            self._begin(
                f"writing {escape_text(asked.path.name)}",
                lambda report: export_file(asked, report),
                asked.path,
                format_command(asked),
            )

    def start_bundle(self, folder: Path, note: str) -> None:
        """Put the frame on screen into a folder, in the background."""
        from pipeline.reporting.repro_bundle import write_bundle

        if not self._may():
            return
        asked = self.make_export_request(folder)
        self._begin(
            "making a case of this frame",
            lambda report: write_bundle(asked.request, asked.settings, asked.frame, folder, note=note, progress=report),
            folder, f"tactoscope replay {dialogs.quote_path(folder)}",
        )  # fmt: skip

    def copy_export_command(self, pane: str, shown: str = "", suffix: str = ".png", frames: str = "") -> None:
        """Put the command that makes this file on the clipboard."""
        clipboard = QGuiApplication.clipboard()
        if clipboard is None or self._controller.views.translation is None:
            self.notification.show_notification(_NOTHING)
            return
        text = format_command(
            self.make_export_request(Path(f"{pane}{suffix}"), pane, shown or self._shown_on_screen(pane), frames)
        )
        clipboard.setText(text)
        self.notification.show_notification(f"copied: {text}")

    def copy_view_command(self) -> None:
        """The command that makes what is on screen: of *Compare* all its tiles, of *Sweep* all its cells."""
        session, opened, clipboard = (
            self._controller.session, self._controller.views.translation, QGuiApplication.clipboard(),
        )  # fmt: skip
        if session.layout.name not in ("compare", "sweep") or opened is None or clipboard is None:
            self.copy_export_command(self._pane_on_screen())
            return
        if session.layout.name == "sweep":
            try:
                text = self._sweeping.format_command(opened.target.name, Path("swept"))
            except TouchError as error:
                self.notification.show_notification(str(error))
                return
        elif session.comparison.tab == "two" and session.variant is None:
            self.notification.show_notification(_NO_B)
            return
        else:
            text = format_compare_command(session, opened.stages[-1], opened.target.name, Path("compared"))
        clipboard.setText(text)
        self.notification.show_notification(f"copied: {text}")

    def copy_section_command(self) -> None:
        """The command that writes the section's curves."""
        line, clipboard = self._controller.section, QGuiApplication.clipboard()
        if line is None or clipboard is None or self._controller.views.translation is None:
            return
        shown = self._window.visible_columns()
        pane = SHEET if set(shown) == set(self._window.route_columns) else ",".join(shown)
        text = format_command(replace(self.make_export_request(Path("section.csv"), pane), section=tuple(line.plain)))
        clipboard.setText(text)
        self.notification.show_notification(f"copied: {text}")

    def show_export_dialog(self, pane: str = "") -> None:
        """Ask what to export."""
        opened = self._controller.views.translation
        if opened is None:
            self.notification.show_notification(_NOTHING)
            return
        panes = [(SHEET, "all, side by side"), (SOURCE, "source")]
        panes += [(name, opened.catalogue.stage(name).title.lower()) for name in opened.stages]
        pane = pane or self._pane_on_screen()
        self.dialog.show_panes(panes, pane, self._shown_on_screen(pane))
        self.dialog.show()
        self.dialog.raise_()

    def ask_bundle(self) -> None:
        """Ask for a note and a folder's name."""
        if self._controller.views.translation is None:
            self.notification.show_notification(_NOTHING)
            return
        note, said = QInputDialog.getText(self._window, "Make a case", "What is to be seen in it")
        if (
            said
            and (folder := dialogs.ask_save_path(self._window, "export_bundle", self._keeping.dialog_folder))
            is not None
        ):
            self.start_bundle(folder, note)

    def _ask_where(self, pane: str, shown: str, suffix: str, frames: str) -> None:
        path = dialogs.ask_export_path(self._window, "Export", suffix, self._keeping.dialog_folder)
        if path is not None:
            self._keeping.preferences.last_folder = path.parent
            self.start_export(self.make_export_request(path, pane, shown, frames))

    def _copy_chosen(self, pane: str, shown: str, suffix: str, frames: str) -> None:
        self.copy_export_command(pane, shown, suffix, frames)

    def _may(self) -> bool:
        if self._controller.views.translation is None or self.job.is_busy:
            self.notification.show_notification(_BUSY if self.job.is_busy else _NOTHING)
            return False
        return True

    def _begin(self, words: str, work: Callable[[JobReporter], object], path: Path, text: str) -> None:
        self.notification.show_notification(f"{words}…", (("Cancel", self.job.cancel),))
        self._then = lambda: self._written(path, text)
        self.job.submit(work)

    def _written(self, path: Path, text: str) -> None:
        def copy_command() -> None:
            clipboard = QGuiApplication.clipboard()
            if clipboard is not None:
                clipboard.setText(text)

        def show_folder() -> None:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(path.parent)))

        self.notification.show_notification(
            f"written: {escape_text(str(path))}", (("Copy as command", copy_command), ("Show folder", show_folder))
        )

    def _progressed(self, _: int, fraction: float, _text: str) -> None:
        self.notification.show_progress(fraction)

    def _finished(self, _: int, _result: object) -> None:
        self._then()

    def _cancelled(self, _: int) -> None:
        self.notification.show_notification("cancelled; nothing was left behind")

    def _failed(self, _: int, error: object) -> None:
        self.notification.hide()
        if isinstance(error, BaseException):
            self._controller.show_problem(error)

    def _pane_on_screen(self) -> str:
        shown, layout = self._window.visible_columns(), self._controller.session.layout
        if layout.name == "inspect" and (panes := layout.resolve_panes(self._window.route_columns)):
            return panes[min(self._window.panes.active_pane, len(panes) - 1)][0]
        return shown[0] if len(shown) == 1 else SHEET

    def _shown_on_screen(self, pane: str) -> str:
        versus = self._controller.views.comparison_mode
        return versus if pane not in (SHEET, SOURCE) and versus in ("truth", "difference") else "computed"

    def _menu(self, name: str, at: QPoint) -> None:
        column, menu = self._window.columns[name], QMenu(self._window)
        choices: tuple[tuple[str, Callable[[], None]], ...] = (
            ("Export this pane…", lambda: self.show_export_dialog(name)),
            ("Copy as command", lambda: self.copy_export_command(name)),
            ("Make a case of this frame…", self.ask_bundle),
        )
        for words, then in choices:
            action = menu.addAction(words)
            assert action is not None
            action.triggered.connect(then)
        menu.popup(column.mapToGlobal(at))
