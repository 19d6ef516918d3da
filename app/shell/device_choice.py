"""The menu *Device*: where networks run, remembered with the machine's settings."""

from collections.abc import Sequence
from functools import partial

from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QMenu

from app.document.autosave import AutosaveController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import Session
from app.window.jobs import LatestJob
from pipeline.stages.networks.devices import AUTO, list_devices


class DeviceController(Feature):
    """Offers what `--device` takes on this machine; cards are looked for when the menu opens."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__(controller)
        self._autosave = autosave
        self._device = controller.session.device  # one of the command line is not remembered
        self._job = LatestJob("devices", self)  # loads torch, which takes seconds
        self._job.finished.connect(self._show_found)
        controller.closing.connect(self._job.close)
        self.menu = QMenu("Device", self._window)
        self.menu.aboutToShow.connect(self._look_for_cards)
        self._window.menus["View"].addMenu(self.menu)

    def show_session(self, session: Session) -> None:
        """Remember a device that was chosen or undone."""
        if session.device != self._device:
            self._device = self._autosave.preferences.device = session.device

    def _look_for_cards(self) -> None:
        self._offer(("cpu",), "looking for graphics cards …")
        self._job.submit(lambda _: list_devices())

    def _show_found(self, _: int, devices: Sequence[str]) -> None:
        self._offer(devices, "no graphics card found")

    def _offer(self, devices: Sequence[str], otherwise: str) -> None:
        """Fill the menu; `otherwise` stands greyed in place of cards."""
        self.menu.clear()
        session = self._controller.session
        for device in (AUTO, *devices):
            action = QAction(device, self.menu)
            action.setCheckable(True)
            action.setChecked(device == session.device)
            action.triggered.connect(partial(self._choose, device))
            self.menu.addAction(action)
        if len(devices) == 1:
            self.menu.addAction(no_card := QAction(otherwise, self.menu))
            no_card.setEnabled(False)

    def _choose(self, device: str, _checked: bool = False) -> None:
        session = self._controller.session
        if device != session.device:
            self._controller.push_session(session.with_device(device), "choose device")
