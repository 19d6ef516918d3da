"""The menu *Device*: where networks run, remembered with the machine's settings."""

from collections.abc import Sequence
from functools import partial
from typing import cast

from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QMenu

from app.document.autosave import AutosaveController
from app.document.background_controller import BackgroundController
from app.document.session_controller import SessionController
from pipeline.stages.networks.devices import AUTO, list_devices


class DeviceController(BackgroundController):
    """Offers what `--device` takes on this machine; cards are looked for when the menu opens."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__("devices", controller)
        self._autosave = autosave
        self._device = controller.session.device  # one of the command line is not remembered
        self.menu = QMenu("Device", self._window)
        self.menu.aboutToShow.connect(self._look_for_cards)
        self._window.menus["View"].addMenu(self.menu)

    def show_session(self) -> None:
        """Remember a device that was chosen or undone."""
        if self._session.device != self._device:
            self._device = self._autosave.preferences.device = self._session.device

    def _look_for_cards(self) -> None:
        self._offer(("cpu",), "looking for graphics cards …")
        self.start(lambda _: list_devices())  # loads torch, which takes seconds

    def show_result(self, result: object) -> None:
        """Offer what was found."""
        self._offer(cast("Sequence[str]", result), "no graphics card found")

    def _offer(self, devices: Sequence[str], otherwise: str) -> None:
        """Fill the menu; `otherwise` stands greyed in place of cards."""
        self.menu.clear()
        for device in (AUTO, *devices):
            action = QAction(device, self.menu)
            action.setCheckable(True)
            action.setChecked(device == self._session.device)
            action.triggered.connect(partial(self._choose, device))
            self.menu.addAction(action)
        if len(devices) == 1:
            self.menu.addAction(no_card := QAction(otherwise, self.menu))
            no_card.setEnabled(False)

    def _choose(self, device: str, _checked: bool = False) -> None:
        if device != self._session.device:
            self._controller.push_session(self._session.with_device(device), "choose device")
