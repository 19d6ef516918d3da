"""Live sensors: the dialog to choose one, and the strip over the stages while one is live."""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QImage, QPixmap
from PyQt6.QtWidgets import (
    QDialog,
    QFormLayout,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from pipeline.core.arrays import Image
from widgets.style.base import ChoiceBox, NumberBox
from widgets.style.styling import fill, make_bold, make_button, set_spacing

# sources that are not the name of a camera
_SIMULATED = "simulated"
_FOLDER = "folder"
_ADDRESS = "address"
_PARTNER_PX = 64  # height of the partner's image


class LiveDialog(QDialog):
    """Emits `watch_requested` with source, sensor, partner, its sensor, object, and rate in Hz."""

    watch_requested = pyqtSignal(list, str, str, str, str, float)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Live")
        self.setObjectName("live_dialog")
        self.source, self.sensor, self.partner_sensor, self.object_box = (
            ChoiceBox(f"live_{name}", f"live {name}")
            for name in ("source", "sensor", "partner_sensor", "object")
        )
        self.rate = NumberBox()
        self.folder = QLineEdit()
        self.partner = QLineEdit()
        self.browse_button = QPushButton("Choose…")
        self.search_button = QPushButton("Search again")
        self.rate.setRange(0.5, 120.0)
        self.rate.setSuffix(" Hz")
        self.rate.setValue(15.0)
        self.rate.setToolTip("frame rate of a simulated sensor, Hz")
        self.folder.setToolTip(
            "a folder that another program writes images into, or an address: http://... or "
            "rtsp://... of a video "
            "stream, ws://HOST:PORT TOPIC of a Foxglove bridge (ROS)"
        )
        self.partner.setPlaceholderText("none")
        self.partner.setToolTip(
            "a second sensor that touches the same object, as on the command line: simulated, "
            "device NAME, camera:1, an address; images of the target's own sensor are the truth"
        )
        form = QFormLayout(self)
        form.addRow("source", fill(QHBoxLayout(), (self.source, 1), self.search_button))
        form.addRow("folder or address", fill(QHBoxLayout(), (self.folder, 1), self.browse_button))
        for label, widget in (
            ("sensor", self.sensor),
            ("partner", self.partner),
            ("partner's sensor", self.partner_sensor),
            ("object", self.object_box),
            ("rate", self.rate),
        ):
            form.addRow(label, widget)
        for label, widget in (
            ("rate", self.rate),
            ("folder", self.folder),
            ("partner", self.partner),
        ):
            widget.setObjectName(f"live_{label}")
            widget.setAccessibleName(f"live {label}")
        self._told = QLabel()
        self._told.setWordWrap(True)
        form.addRow(self._told)
        self.watch = QPushButton("Watch")
        self.watch.setDefault(True)
        form.addRow(self.watch)
        self.watch.clicked.connect(self._watch)
        self.source.currentIndexChanged.connect(self._fit)
        self.folder.textChanged.connect(self._fit)

    def show_choices(self, sensors: Mapping[str, str], tools: Sequence[str]) -> None:
        """Offer these sensors (name -> title) and objects."""
        self.sensor.offer({"": "detect from name or images", **sensors})
        self.partner_sensor.offer({"": "the target", **sensors})
        self.object_box.offer({name: name.replace("_", " ") for name in tools}, "sphere")

    def show_cameras(self, cameras: Sequence[tuple[str, str]]) -> None:
        """Offer the connected cameras as (name, source)."""
        self.source.offer(
            {
                _SIMULATED: "simulated sensor",
                **dict(cameras),
                _FOLDER: "growing folder",
                _ADDRESS: "network address",
            }
        )
        self._told.setText("" if cameras else "no camera is connected")
        self._fit()

    def show_folder(self, folder: str) -> None:
        """Show the selected folder."""
        self.folder.setText(folder)
        self.source.setCurrentIndex(self.source.findData(_FOLDER))

    def _fit(self) -> None:
        source = self.source.choice
        is_written = source in {_FOLDER, _ADDRESS}
        self.folder.setEnabled(is_written)
        self.browse_button.setEnabled(source != _ADDRESS)
        for widget in (self.object_box, self.rate):
            widget.setEnabled(source == _SIMULATED)
        self.watch.setEnabled(not is_written or bool(self.folder.text().strip()))

    def _watch(self) -> None:
        source = self.source.choice
        written = self.folder.text().strip()
        words = {
            _SIMULATED: [_SIMULATED],
            _FOLDER: [_FOLDER, written],
            _ADDRESS: written.split(maxsplit=1),
        }.get(source, ["device", source])
        self.watch_requested.emit(
            words,
            self.sensor.choice,
            self.partner.text().strip(),
            self.partner_sensor.choice,
            self.object_box.choice,
            self.rate.value(),
        )
        self.accept()


class LiveBar(QFrame):
    """Hidden while no sensor is live."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("live_bar")
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self._title = QLabel()
        self._rates = QLabel()
        self._wrong = QLabel()
        self._partner = QLabel()
        self._partner.setObjectName("live_partner")
        self._partner.setToolTip("what the partner took at the time of the frame on screen")
        make_bold(self._title)
        make_bold(self._wrong)
        self._rates.setToolTip(
            "frames per second over the last two seconds; lost: counted by the sensor"
        )
        self._wrong.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        zero_tip = "Use the last frames as the reference image; nothing may touch the sensor"
        self.follow = make_button("Follow", "live_follow", "Follow the newest frame")
        self.zero = make_button("Set zero", "live_set", zero_tip)
        self.record = make_button(
            "Record…", "live_record", "Record every frame to a file that can be opened at any time"
        )
        self.stop = make_button(
            "Stop", "live_stop", "Disconnect the sensor; the frames stay on screen"
        )
        self.follow.setCheckable(True)
        self.record.setCheckable(True)
        row = set_spacing(QHBoxLayout(self), 6, (8, 3, 8, 3))
        fill(
            row,
            self._title,
            self._partner,
            self._rates,
            (self._wrong, 1),
            self.follow,
            self.zero,
            self.record,
            self.stop,
        )
        self.hide()

    @property
    def text(self) -> str:
        """All visible text."""
        return " ".join(label.text() for label in (self._title, self._rates, self._wrong))

    def show_source(self, title: str) -> None:
        """Show the name of the live sensor."""
        self._title.setText(title)
        self._partner.clear()
        self.show_rates("connecting")
        self.show()

    def show_partner(self, image: Image | None) -> None:
        """Show what the partner took (rows, cols, 3), a few lines high; None = nothing."""
        if image is None:
            self._partner.setText("no partner")
            return
        rows, cols, _ = image.shape
        shown = QImage(image.tobytes(), cols, rows, 3 * cols, QImage.Format.Format_RGB888)
        self._partner.setPixmap(QPixmap.fromImage(shown.scaledToHeight(_PARTNER_PX)))

    def show_rates(self, rates: str, wrong: str = "") -> None:
        """Show the frame rate and what is wrong with it."""
        self._rates.setText(rates)
        self._wrong.setText(wrong)
        self._wrong.setToolTip(wrong)

    def show_state(self, *, following: bool, recording: bool) -> None:
        """Show whether the newest frame is followed, and whether frames are recorded."""
        self.follow.setChecked(following)
        self.record.setChecked(recording)
        self.record.setText("Stop recording" if recording else "Record…")
