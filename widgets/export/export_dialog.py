"""Export dialog: what to export and in which format; non-modal."""

from collections.abc import Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import (
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)

from widgets.style.base import ChoiceBox
from widgets.style.styling import fill

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


class ExportDialog(QDialog):
    """Emits `export_wanted` and `command_wanted` with pane, content, suffix and frames."""

    export_requested = pyqtSignal(str, str, str, str)
    command_requested = pyqtSignal(str, str, str, str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Export")
        self.setObjectName("export_dialog")
        contents = {name: name for name in ("computed", "truth", "difference")}
        self.pane_box = ChoiceBox("export_pane", "export pane")
        self.frames = QLineEdit()
        self.content_box = ChoiceBox("export_shows", "export shows", contents)
        self.format_box = ChoiceBox(
            "export_as", "export as", {suffix: words for suffix, words, _ in FORMATS}
        )
        self.frames.setObjectName("export_frames")
        self.frames.setAccessibleName("export frames")
        self.frames.setPlaceholderText("all, or for example 0,3-7")
        self.frames.setToolTip("frames of a table or a video, by number")
        form = QFormLayout(self)
        for label, widget in (
            ("pane", self.pane_box),
            ("shows", self.content_box),
            ("as", self.format_box),
            ("frames", self.frames),
        ):
            form.addRow(label, widget)
        self._told = QLabel()
        self._told.setWordWrap(True)
        form.addRow(self._told)
        self.copy = QPushButton("Copy as command")
        self.write = QPushButton("Export…")
        self.write.setDefault(True)
        form.addRow(fill(QHBoxLayout(), 1, self.copy, self.write))
        self.copy.clicked.connect(lambda: self.command_requested.emit(*self.selection))
        self.write.clicked.connect(self._export)
        for box in (self.pane_box, self.format_box):
            box.currentIndexChanged.connect(self._fit)

    @property
    def selection(self) -> tuple[str, str, str, str]:
        """Pane, content, suffix, frames."""
        shown = self.content_box.choice if self.content_box.isEnabled() else "computed"
        frames = self.frames.text().strip() if self.frames.isEnabled() else ""
        return self.pane_box.choice, shown, self.format_box.choice, frames

    def show_panes(self, panes: Sequence[tuple[str, str]], chosen: str, shown: str) -> None:
        """Offer these panes (name, title) and select one of them with its content."""
        self.pane_box.offer(dict(panes), chosen)
        self.content_box.setCurrentIndex(max(0, self.content_box.findData(shown)))
        self._fit()

    def _fit(self) -> None:
        """Enable only the options of the selected pane and format."""
        pane = self.pane_box.choice
        of = next((of for suffix, _, of in FORMATS if suffix == self.format_box.choice), "every")
        self.content_box.setEnabled(pane not in (SHEET, "source", ""))
        self.frames.setEnabled(of == "frames")
        wrong = of == "pane" and pane == SHEET
        self._told.setText("a sheet has no points; select one pane" if wrong else "")
        for button in (self.copy, self.write):
            button.setEnabled(not wrong)

    def _export(self) -> None:
        self.export_requested.emit(*self.selection)
        self.accept()
