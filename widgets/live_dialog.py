"""Dialog to choose a live sensor: simulated, a connected camera, or a growing folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import (
    QComboBox,
    QDialog,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)


class LiveDialog(QDialog):
    """Emits `watch_requested` with source, sensor, object and rate in Hz."""

    watch_requested = pyqtSignal(list, str, str, float)
    folder_requested = pyqtSignal()
    cameras_requested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Live")
        self.setObjectName("live_dialog")
        self.source, self.sensor, self.object_box = QComboBox(), QComboBox(), QComboBox()
        self.rate, self.folder = QDoubleSpinBox(), QLineEdit()
        browse, look = QPushButton("Choose…"), QPushButton("Search again")
        self.rate.setRange(0.5, 120.0)
        self.rate.setSuffix(" Hz")
        self.rate.setValue(15.0)
        self.rate.setToolTip("frame rate of a simulated sensor, Hz")
        self.folder.setToolTip("a folder that another program writes images into")
        form = QFormLayout(self)
        first, second = QHBoxLayout(), QHBoxLayout()
        first.addWidget(self.source, 1)
        first.addWidget(look)
        second.addWidget(self.folder, 1)
        second.addWidget(browse)
        form.addRow("source", first)
        form.addRow("folder", second)
        named = (("sensor", self.sensor), ("object", self.object_box), ("rate", self.rate))
        for label, widget in named:
            form.addRow(label, widget)
        for label, widget in (*named, ("source", self.source), ("folder", self.folder)):
            widget.setObjectName(f"live_{label}")
            widget.setAccessibleName(f"live {label}")
        self._told = QLabel()
        self._told.setWordWrap(True)
        form.addRow(self._told)
        self.watch = QPushButton("Watch")
        self.watch.setDefault(True)
        form.addRow(self.watch)
        look.clicked.connect(self.cameras_requested)
        browse.clicked.connect(self.folder_requested)
        self.watch.clicked.connect(self._watch)
        self.source.currentIndexChanged.connect(self._fit)
        self.folder.textChanged.connect(self._fit)

    def show_choices(self, sensors: Mapping[str, str], tools: Sequence[str]) -> None:
        """Offer these sensors (name -> title) and objects."""
        self.sensor.addItem("detect from name or images", "")
        for name, title in sensors.items():
            self.sensor.addItem(title, name)
        for name in tools:
            self.object_box.addItem(name, name)
        self.object_box.setCurrentIndex(max(0, self.object_box.findData("sphere")))

    def show_cameras(self, cameras: Sequence[tuple[str, str]]) -> None:
        """Offer the connected cameras as (name, source)."""
        self.source.clear()
        self.source.addItem("simulated sensor", ["simulated"])
        for name, words in cameras:
            self.source.addItem(words, ["device", name])
        self.source.addItem("growing folder", ["folder"])
        self._told.setText("" if cameras else "no camera is connected")
        self._fit()

    def show_folder(self, folder: str) -> None:
        """Show the selected folder."""
        self.folder.setText(folder)
        self.source.setCurrentIndex(self.source.count() - 1)

    def _fit(self) -> None:
        words = self.source.currentData() or ["simulated"]
        self.folder.setEnabled(words[0] == "folder")
        for widget in (self.object_box, self.rate):
            widget.setEnabled(words[0] == "simulated")
        self.watch.setEnabled(words[0] != "folder" or bool(self.folder.text().strip()))

    def _watch(self) -> None:
        words = list(self.source.currentData() or ["simulated"])
        if words[0] == "folder":
            words.append(self.folder.text().strip())
        self.watch_requested.emit(words, self.sensor.currentData(), self.object_box.currentData(), self.rate.value())
        self.accept()
