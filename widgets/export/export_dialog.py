"""Export dialog: what to export and in which format; non-modal."""

import re
from collections.abc import Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import (
    QDialog,
    QFormLayout,
    QPushButton,
    QWidget,
)

from widgets.style.base import ChoiceBox
from widgets.style.styling import make_line, make_row, make_text, name_widget

FORMATS = (  # suffix, title, content it can hold
    (".png", "image, PNG", "every"),
    (".pdf", "image, PDF", "every"),
    (".ply", "points in mm, PLY", "pane"),
    (".npz", "arrays, NPZ", "every"),
    (".csv", "metrics of all frames, CSV", "frames"),
    (".mp4", "video of the frames, MP4", "frames"),
    (".avi", "video of the frames, AVI", "frames"),
    (".webm", "video of the frames, WebM", "frames"),
    (".webp", "video of the frames, animated WebP", "frames"),
)
SHEET = "sheet"
SCENES = ("scene", "presentation")  # drawn in any size
_FILM = "the press in motion, of this frame or of those named"
_SIZE = re.compile(r"\s*(\d{1,5})\s*[x\u00d7]\s*(\d{1,5})\s*")
_SCENE_FORMATS = (".png", ".pdf", ".mp4", ".avi", ".webm", ".webp")


class ExportDialog(QDialog):
    """Emits `export_wanted` and `command_wanted` with pane, content, suffix, frames and size."""

    export_requested = pyqtSignal(str, str, str, str, object)
    command_requested = pyqtSignal(str, str, str, str, object)

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Export")
        name_widget(self, "export_dialog")
        contents = {name: name for name in ("computed", "truth", "difference")}
        self.pane_box = ChoiceBox("export_pane", "export pane")
        self.content_box = ChoiceBox("export_shows", "export shows", contents)
        self.format_box = ChoiceBox(
            "export_as", "export as", {suffix: words for suffix, words, _ in FORMATS}
        )
        self.frames = make_line(
            "export_frames",
            "export frames",
            "all, or for example 0,3-7",
            "frames of a table or a video, by number",
        )
        self.size_line = make_line("export_size", "export size", "pixels, for example 1920 x 1080")
        form = QFormLayout(self)
        for label, widget in (
            ("pane", self.pane_box),
            ("shows", self.content_box),
            ("as", self.format_box),
            ("frames", self.frames),
            ("size", self.size_line),
        ):
            form.addRow(label, widget)
        self._told = make_text()
        form.addRow(self._told)
        self.copy = QPushButton("Copy as command")
        self.write = QPushButton("Export…")
        self.write.setDefault(True)
        form.addRow(make_row(6, 1, self.copy, self.write))
        self.copy.clicked.connect(lambda: self.command_requested.emit(*self.selection))
        self.write.clicked.connect(self._export)
        self.size_line.textChanged.connect(self._fit)
        for box in (self.pane_box, self.format_box):
            box.currentIndexChanged.connect(self._fit)

    @property
    def selection(self) -> tuple[str, str, str, str, tuple[int, int] | None]:
        """Pane, content, suffix, frames, size in pixels."""
        shown = self.content_box.choice if self.content_box.isEnabled() else "computed"
        frames = self.frames.text().strip() if self.frames.isEnabled() else ""
        sides = _SIZE.fullmatch(self.size_line.text()) if self.size_line.isEnabled() else None
        size = (int(sides[1]), int(sides[2])) if sides else None
        return self.pane_box.choice, shown, self.format_box.choice, frames, size

    def show_panes(
        self, panes: Sequence[tuple[str, str]], chosen: str, shown: str, suffix: str
    ) -> None:
        """Offer these panes (name, title) and select one of them with its content and format."""
        self.format_box.choose(suffix)
        self.pane_box.offer(dict(panes), chosen)
        self.content_box.choose(shown)
        self._fit()

    def _fit(self) -> None:
        """Enable only the options of the selected pane and format."""
        pane = self.pane_box.choice
        of = next((of for suffix, _, of in FORMATS if suffix == self.format_box.choice), "every")
        self.content_box.setEnabled(pane not in (SHEET, "source", "", *SCENES))
        self.size_line.setEnabled(pane in SCENES)
        self.frames.setEnabled(of == "frames")
        text = "a sheet has no points; select one pane" if of == "pane" and pane == SHEET else ""
        if pane in SCENES and self.format_box.choice not in _SCENE_FORMATS:
            text = "this is an image or a film; select PNG, PDF or a video"
        size = self.size_line.text().strip()
        if pane in SCENES and size and not _SIZE.fullmatch(size):
            text = "a size is width x height in pixels, for example 1920 x 1080"
        is_film = pane == SCENES[0] and of == "frames"
        self._told.setText(text or (_FILM if is_film else ""))
        for button in (self.copy, self.write):
            button.setEnabled(not text)

    def _export(self) -> None:
        self.export_requested.emit(*self.selection)
        self.accept()
