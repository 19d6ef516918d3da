"""Page of the *Track* layout: how the touched object moves over the frames, and its fused surface in 3D."""

from __future__ import annotations

from collections.abc import Mapping

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QProgressBar, QPushButton, QSplitter, QVBoxLayout, QWidget

from pipeline.tracking.track_record import TrackRecord
from widgets.styling import make_bold, make_command_button, set_spacing
from widgets.track_plot import TrackPlot
from widgets.view_3d_panel import View3DPanel

_PLOT_SIZE = 620  # of 1000
_START, _CANCEL = "Track", "Cancel"


class TrackPage(QWidget):
    """Stage and start over a sentence over plot and surface; `start_requested` carries the stage to follow."""

    start_requested = pyqtSignal(str)
    cancel_requested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.stage_box, self.start_button, self.progress_bar = QComboBox(), QPushButton(_START), QProgressBar()
        self.plot, self.scene, self._sentence = TrackPlot(), View3DPanel(), QLabel()
        self.stage_box.setObjectName("tracked_stage")
        self.stage_box.setAccessibleName("touch to follow")
        self.stage_box.setToolTip("Membrane to follow: the source's, or that of the generated touch")
        self.stage_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
        self.start_button.setObjectName("start_track")
        self.start_button.clicked.connect(self._press)
        self.progress_bar.setFixedWidth(160)
        self.progress_bar.setRange(0, 1000)
        self.progress_bar.setAccessibleName("progress of the track")
        make_bold(self._sentence)
        self._sentence.setTextFormat(Qt.TextFormat.PlainText)
        self._sentence.setWordWrap(True)
        self.scene.view.setAccessibleName("touched surface")
        self.scene.view.setMinimumSize(220, 160)
        self.scene.caption.set_texts("sensor frame of the first frame, mm")
        self._head = set_spacing(QHBoxLayout(), 6)
        for widget in (QLabel("follow"), self.stage_box, self.start_button, self.progress_bar):
            self._head.addWidget(widget)
        self._head.addStretch(1)
        self._split = QSplitter(Qt.Orientation.Horizontal)
        self._split.setObjectName("track_split")
        for widget in (self.plot, self.scene):
            self._split.addWidget(widget)
        self._split.setSizes([_PLOT_SIZE, 1000 - _PLOT_SIZE])
        layout = set_spacing(QVBoxLayout(self), 4, (6, 4, 6, 2))
        layout.addLayout(self._head)
        layout.addWidget(self._sentence)
        layout.addWidget(self._split, 1)
        self.show_progress(None)
        self.clear("")

    def add_command(self, action: QAction) -> None:
        """Add a command to the controls."""
        self._head.addWidget(make_command_button(action))

    @property
    def sentence(self) -> str:
        """The summary of the track, or what to do."""
        return self._sentence.text()

    def offer_stages(self, stages: Mapping[str, str]) -> None:
        """Offer name -> title of the stages whose membrane can be followed."""
        self.start_button.setEnabled(bool(stages))
        if [self.stage_box.itemData(i) for i in range(self.stage_box.count())] == list(stages):
            return
        chosen = self.stage_box.currentData()
        with QSignalBlocker(self.stage_box):
            self.stage_box.clear()
            for name, title in stages.items():
                self.stage_box.addItem(title, name)
            self.stage_box.setCurrentIndex(max(0, self.stage_box.findData(chosen)))

    def show_progress(self, fraction: float | None) -> None:
        """Show how far a run is, and offer to cancel it; None shows that there is none."""
        self.progress_bar.setVisible(fraction is not None)
        self.progress_bar.setValue(round(1000 * (fraction or 0.0)))
        self.start_button.setText(_START if fraction is None else _CANCEL)

    def show_record(self, record: TrackRecord, name: str) -> None:
        """Show a track and its summary."""
        self.plot.show_track(record.rows, record.key_frames)
        self._sentence.setText(f"{name}: {describe_record(record)}")
        self.scene.legend.setText("fused surface and the sensor's path on it" if record.patch is not None else "")
        self.scene.setVisible(record.patch is not None)

    def clear(self, text: str) -> None:
        """Show no track, and why."""
        self.plot.show_track((), ())
        self._sentence.setText(text)
        self.scene.hide()

    def _press(self) -> None:
        if self.start_button.text() == _CANCEL:
            self.cancel_requested.emit()
        else:
            self.start_requested.emit(str(self.stage_box.currentData() or ""))


def describe_record(record: TrackRecord) -> str:
    """Return the counts of a track, its drift, and what was not measured."""
    counts = [f"{record.count('tracked')} of {len(record.rows)} frames tracked", f"{record.count('lost')} lost",
              f"{record.count('no contact')} without contact"]  # fmt: skip
    counts += [f"{record.n_parts} parts"] if record.n_parts > 1 else []
    counts += [f"key frames: {len(record.key_frames)}", f"closed loops: {record.n_loops}"]
    text = ", ".join(counts)
    if record.error is not None:
        text += (
            f"; largest error {record.error.drift_mm:.3f} mm and {record.error.drift_deg:.2f}° over "
            f"{record.error.path_mm:.1f} mm and {record.error.turned_deg:.0f}°"
        )
    if record.weak_directions:
        text += f"; not measured in some frames: {', '.join(record.weak_directions[:3])}"
    return text
