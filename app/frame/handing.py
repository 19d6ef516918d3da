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

from app.frame import dialogs
from app.frame.instrument import Instrument
from app.frame.keeping import Keeping
from app.frame.sweeping import Sweeping
from app.work.compared_command import compare_command
from app.work.jobs import LatestJob, Report
from app.work.opening import request_of
from pipeline.base.errors import TouchError
from pipeline.base.text import plain
from pipeline.reporting.asked import SHEET, SOURCE, Asked, Shown, command, settings_of
from widgets.export_dialog import ExportDialog
from widgets.offer import Offer

_NOTHING = "nothing is open that could be exported; open a recording first"
_NO_B = "nothing is held as B yet; hold these settings, or choose another recording, and copy then"
_BUSY = "something is being written already; wait for it, or cancel it"


class Handing(QObject):
    """Between the commands and the pipeline's exports."""

    def __init__(self, instrument: Instrument, keeping: Keeping, sweeping: Sweeping) -> None:
        super().__init__(instrument)
        self._instrument, self._keeping, self._window = instrument, keeping, instrument.window
        self._sweeping = sweeping
        self.offer, self.dialog = Offer("handing_offer"), ExportDialog(self._window)
        self._window.add_strip(self.offer)
        self.job = LatestJob("handing", self)
        self._then: Callable[[], None] = lambda: None
        self.job.progressed.connect(self._progressed)
        self.job.finished.connect(self._finished)
        self.job.cancelled.connect(self._cancelled)
        self.job.failed.connect(self._failed)
        instrument.closing.connect(self.job.close)
        self._window.on("export", self.ask)
        self._window.on("copy_command", self.copy_shown)
        self._window.section_tab.command_wanted.connect(self.copy_section)
        self._window.on("make_case", self.ask_case)
        self.dialog.export_wanted.connect(self._ask_where)
        self.dialog.command_wanted.connect(self._copy_chosen)
        for name, column in self._window.columns.items():
            column.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
            column.customContextMenuRequested.connect(partial(self._menu, name))

    def asked(self, path: Path, pane: str = SHEET, shown: str = "computed", frames: str = "") -> Asked:
        """What is on screen, asked for as one file."""
        session, opened = self._instrument.session, self._instrument.screen.opened
        assert opened is not None
        params = {method.slot: session.params_of(method) for method in opened.methods}
        return Asked(
            request=replace(request_of(session), offsets=session.offsets), pane=pane, shown=cast("Shown", shown),
            settings=settings_of({**params, "display": session.display}), frame=session.frame, frames=frames, path=path,
        )  # fmt: skip

    def export(self, asked: Asked) -> None:
        """Write it in the background."""
        from pipeline.reporting.exports import export

        if self._may():
            self._begin(
                f"writing {plain(asked.path.name)}", lambda report: export(asked, report), asked.path, command(asked)
            )

    def make_case(self, folder: Path, note: str) -> None:
        """Put the frame on screen into a folder, in the background."""
        from pipeline.reporting.cases import make_case

        if not self._may():
            return
        asked = self.asked(folder)
        self._begin(
            "making a case of this frame",
            lambda report: make_case(asked.request, asked.settings, asked.frame, folder, note=note, progress=report),
            folder, f"tactoscope case {dialogs.quoted(folder)}",
        )  # fmt: skip

    def copy(self, pane: str, shown: str = "", suffix: str = ".png", frames: str = "") -> None:
        """Put the command that makes this file on the clipboard."""
        clipboard = QGuiApplication.clipboard()
        if clipboard is None or self._instrument.screen.opened is None:
            self.offer.show_offer(_NOTHING)
            return
        text = command(self.asked(Path(f"{pane}{suffix}"), pane, shown or self._shown_on_screen(pane), frames))
        clipboard.setText(text)
        self.offer.show_offer(f"copied: {text}")

    def copy_shown(self) -> None:
        """The command that makes what is on screen: of *Compare* all its tiles, of *Sweep* all its cells."""
        session, opened, clipboard = (
            self._instrument.session, self._instrument.screen.opened, QGuiApplication.clipboard(),
        )  # fmt: skip
        if session.layout.name not in ("compare", "sweep") or opened is None or clipboard is None:
            self.copy(self._pane_on_screen())
            return
        if session.layout.name == "sweep":
            try:
                text = self._sweeping.command(opened.target.name, Path("swept"))
            except TouchError as error:
                self.offer.show_offer(str(error))
                return
        elif session.compared.tab == "two" and session.held is None:
            self.offer.show_offer(_NO_B)
            return
        else:
            text = compare_command(session, opened.slots[-1], opened.target.name, Path("compared"))
        clipboard.setText(text)
        self.offer.show_offer(f"copied: {text}")

    def copy_section(self) -> None:
        """The command that writes the section's curves."""
        line, clipboard = self._instrument.section, QGuiApplication.clipboard()
        if line is None or clipboard is None or self._instrument.screen.opened is None:
            return
        shown = self._window.visible_columns()
        pane = SHEET if set(shown) == set(self._window.here) else ",".join(shown)
        text = command(replace(self.asked(Path("section.csv"), pane), section=tuple(line.plain)))
        clipboard.setText(text)
        self.offer.show_offer(f"copied: {text}")

    def ask(self, pane: str = "") -> None:
        """Ask what to export."""
        opened = self._instrument.screen.opened
        if opened is None:
            self.offer.show_offer(_NOTHING)
            return
        panes = [(SHEET, "all, side by side"), (SOURCE, "source")]
        panes += [(name, opened.catalogue.slot(name).title.lower()) for name in opened.slots]
        pane = pane or self._pane_on_screen()
        self.dialog.show_panes(panes, pane, self._shown_on_screen(pane))
        self.dialog.show()
        self.dialog.raise_()

    def ask_case(self) -> None:
        """Ask for a note and a folder's name."""
        if self._instrument.screen.opened is None:
            self.offer.show_offer(_NOTHING)
            return
        note, said = QInputDialog.getText(self._window, "Make a case", "What is to be seen in it")
        if said and (folder := dialogs.to_save(self._window, "make_case", self._keeping.folder)) is not None:
            self.make_case(folder, note)

    def _ask_where(self, pane: str, shown: str, suffix: str, frames: str) -> None:
        path = dialogs.to_save_as(self._window, "Export", suffix, self._keeping.folder)
        if path is not None:
            self._keeping.remembered.folder = path.parent
            self.export(self.asked(path, pane, shown, frames))

    def _copy_chosen(self, pane: str, shown: str, suffix: str, frames: str) -> None:
        self.copy(pane, shown, suffix, frames)

    def _may(self) -> bool:
        if self._instrument.screen.opened is None or self.job.busy:
            self.offer.show_offer(_BUSY if self.job.busy else _NOTHING)
            return False
        return True

    def _begin(self, words: str, work: Callable[[Report], object], path: Path, text: str) -> None:
        self.offer.show_offer(f"{words}…", (("Cancel", self.job.cancel),))
        self._then = lambda: self._written(path, text)
        self.job.submit(work)

    def _written(self, path: Path, text: str) -> None:
        def copy() -> None:
            clipboard = QGuiApplication.clipboard()
            if clipboard is not None:
                clipboard.setText(text)

        def show() -> None:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(path.parent)))

        self.offer.show_offer(f"written: {plain(str(path))}", (("Copy as command", copy), ("Show folder", show)))

    def _progressed(self, _: int, fraction: float, _text: str) -> None:
        self.offer.show_progress(fraction)

    def _finished(self, _: int, _result: object) -> None:
        self._then()

    def _cancelled(self, _: int) -> None:
        self.offer.show_offer("cancelled; nothing was left behind")

    def _failed(self, _: int, error: object) -> None:
        self.offer.hide()
        if isinstance(error, BaseException):
            self._instrument.show_problem(error)

    def _pane_on_screen(self) -> str:
        shown, layout = self._window.visible_columns(), self._instrument.session.layout
        if layout.name == "inspect" and (panes := layout.panes_of(self._window.here)):
            return panes[min(self._window.panes.active, len(panes) - 1)][0]
        return shown[0] if len(shown) == 1 else SHEET

    def _shown_on_screen(self, pane: str) -> str:
        versus = self._instrument.screen.versus
        return versus if pane not in (SHEET, SOURCE) and versus in ("truth", "difference") else "computed"

    def _menu(self, name: str, at: QPoint) -> None:
        column, menu = self._window.columns[name], QMenu(self._window)
        choices: tuple[tuple[str, Callable[[], None]], ...] = (
            ("Export this pane…", lambda: self.ask(name)),
            ("Copy as command", lambda: self.copy(name)),
            ("Make a case of this frame…", self.ask_case),
        )
        for words, then in choices:
            action = menu.addAction(words)
            assert action is not None
            action.triggered.connect(then)
        menu.popup(column.mapToGlobal(at))
