"""The *Folder* layout: the recordings of a folder as one table, read in the background."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

from app.document.background_controller import BackgroundController
from app.document.requests import open_request
from app.document.session_controller import SessionController
from app.window.jobs import JobReporter
from pipeline.core.progress import SubProgress
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.reports.folder_overview import (
    RecordingRow,
    WorstFrame,
    find_worst_frame,
    load_row,
    load_worst_frame,
    summarise_recording,
)
from pipeline.translation.translate import Request, Translation

_Part = tuple[Path, RecordingRow | WorstFrame]


class FolderController(BackgroundController):
    """Connects the page with the session; a recording that is chosen opens in *Look*."""

    def __init__(self, controller: SessionController) -> None:
        self._page = controller.window.folder
        super().__init__("folder", controller, self._page.run_bar)
        self.folder: Path | None = None
        self._page.recording_chosen.connect(controller.open_path)
        self._page.run_bar.start_button.clicked.connect(self.rank)
        controller.folder_requested.connect(self.open_folder)

    def open_folder(self, folder: Path, paths: tuple[Path, ...]) -> None:
        """Show the recordings of a folder, those that are known first."""
        self.folder = folder
        self._page.show_paths(folder, paths)
        layout = replace(self._session.layout, name="folder")
        self._change("open folder", layout=layout)
        self._window.offer_layout("folder", offered=True)
        self.start(partial(_read_rows, paths))

    def rank(self) -> None:
        """Find the worst frame of every recording."""
        catalogue = self._controller.catalogue
        self.start(partial(_rank_recordings, self._page.paths, catalogue))

    def show_part(self, part: object) -> None:
        """Fill one row."""
        self._page.show_part(*cast("_Part", part))
        self._page.show_count(self.folder)


def _read_rows(paths: tuple[Path, ...], report: JobReporter) -> None:
    """Deliver the row of every recording: first what the cache holds, then what is read."""
    left: list[Path] = []
    for path in paths:
        row = load_row(path)
        if row is None:
            left.append(path)
            continue
        report.deliver((path, row))
        worst = load_worst_frame(path)
        if worst is not None:
            report.deliver((path, worst))
    for done, path in enumerate(left):
        part = SubProgress(report, done / len(left), 1.0 / len(left), path.name)
        report.deliver((path, summarise_recording(path, part)))


def _rank_recordings(paths: tuple[Path, ...], catalogue: Catalogue, report: JobReporter) -> None:
    """Deliver the worst frame of every recording, after the rows that are not known yet."""
    _read_rows(paths, report)

    def open_path(path: Path) -> Translation:
        return open_request(Request(recording=path, target=""), catalogue)

    for done, path in enumerate(paths):
        part = SubProgress(report, done / len(paths), 1.0 / len(paths), path.name)
        report.deliver((path, find_worst_frame(path, open_path, part)))
