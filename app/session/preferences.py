"""Preferences of the program between two starts: recent files, last folder, theme, device, window
geometry.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, cast, get_args

from PyQt6.QtCore import QByteArray, QSettings

from pipeline.stages.networks.devices import AUTO

Theme = Literal["light", "dark", "system"]
_MAX_RECENT = 12
# raise it when docks or tool bars change their object names: old window states then do not apply
_STATE_VERSION = 3


class Preferences:
    """The program's settings file; of what it holds the device alone reaches results."""

    def __init__(self) -> None:
        kind = QSettings.Format.IniFormat
        scope = QSettings.Scope.UserScope
        self._settings = QSettings(kind, scope, "Tactoscope", "Tactoscope")

    @property
    def recent_files(self) -> tuple[Path, ...]:
        """Files opened last, newest first; missing files are left out."""
        value: object = self._settings.value("recent", [])
        names = cast("Sequence[object]", [value] if isinstance(value, str) else value or [])
        paths = [Path(name) for name in names if isinstance(name, str)]
        return tuple(path for path in paths if _exists(path))

    def add_recent(self, path: Path) -> None:
        """Put `path` first in the list of recent files, and remember its folder."""
        path = path.absolute()
        others = [str(old) for old in self.recent_files if old != path]
        self._settings.setValue("recent", [str(path), *others][:_MAX_RECENT])
        self.last_folder = path.parent

    def clear_recent(self) -> None:
        """Empty the list of recent files."""
        self._settings.remove("recent")

    @property
    def last_folder(self) -> Path | None:
        """Folder of the last chosen file; None if it is missing."""
        path = Path(str(self._settings.value("folder", "")))
        return path if path.name and _exists(path) else None

    @last_folder.setter
    def last_folder(self, path: Path) -> None:
        self._settings.setValue("folder", str(path))

    @property
    def window_geometry(self) -> tuple[QByteArray, QByteArray] | None:
        """(geometry, state) of the last window, as Qt saves them.

        None if there is none of this version.
        """
        geometry, state = (
            self._settings.value(f"window{_STATE_VERSION}/{key}") for key in ("geometry", "state")
        )
        return (
            (geometry, state)
            if isinstance(geometry, QByteArray) and isinstance(state, QByteArray)
            else None
        )

    @window_geometry.setter
    def window_geometry(self, pair: tuple[QByteArray, QByteArray]) -> None:
        for key, value in zip(("geometry", "state"), pair, strict=True):
            self._settings.setValue(f"window{_STATE_VERSION}/{key}", value)

    @property
    def theme(self) -> Theme:
        """Colour theme; "dark" unless chosen."""
        value: object = self._settings.value("theme", "dark")
        return next((theme for theme in get_args(Theme) if theme == value), "dark")

    @theme.setter
    def theme(self, theme: Theme) -> None:
        self._settings.setValue("theme", theme)

    @property
    def device(self) -> str:
        """Device that networks run on, unchecked; "auto" unless chosen."""
        return str(self._settings.value("device", AUTO))

    @device.setter
    def device(self, device: str) -> None:
        self._settings.setValue("device", device)

    def write(self) -> None:
        """Write the settings to disk now."""
        self._settings.sync()


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False
