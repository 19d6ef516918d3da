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
_GEOMETRY = "window3"


class Preferences(QSettings):
    """The program's settings file; of what it holds the device alone reaches results."""

    def __init__(self) -> None:
        kind = QSettings.Format.IniFormat
        super().__init__(kind, QSettings.Scope.UserScope, "Tactoscope", "Tactoscope")

    @property
    def recent_files(self) -> tuple[Path, ...]:
        """Files opened last, newest first; missing files are left out."""
        value: object = self.value("recent", [])
        names = cast("Sequence[object]", [value] if isinstance(value, str) else value or [])
        paths = [Path(name) for name in names if isinstance(name, str)]
        return tuple(path for path in paths if _exists(path))

    def add_recent(self, path: Path) -> None:
        """Put `path` first in the list of recent files, and remember its folder."""
        path = path.absolute()
        others = [str(old) for old in self.recent_files if old != path]
        self.setValue("recent", [str(path), *others][:_MAX_RECENT])
        self.last_folder = path.parent

    def clear_recent(self) -> None:
        """Empty the list of recent files."""
        self.remove("recent")

    @property
    def last_folder(self) -> Path | None:
        """Folder of the last chosen file; None if it is missing."""
        path = Path(str(self.value("folder", "")))
        return path if path.name and _exists(path) else None

    @last_folder.setter
    def last_folder(self, path: Path) -> None:
        self.setValue("folder", str(path))

    @property
    def window_geometry(self) -> Sequence[QByteArray]:
        """Geometry and state of the last window, as Qt saves them.

        Empty if there is none of this version.
        """
        kept = (self.value(f"{_GEOMETRY}/{key}") for key in ("geometry", "state"))
        known = [part for part in kept if isinstance(part, QByteArray)]
        return known if len(known) == 2 else ()

    @window_geometry.setter
    def window_geometry(self, pair: Sequence[QByteArray]) -> None:
        for key, part in zip(("geometry", "state"), pair, strict=True):
            self.setValue(f"{_GEOMETRY}/{key}", part)

    @property
    def theme(self) -> Theme:
        """Colour theme; "dark" unless chosen."""
        value: object = self.value("theme")
        return next((theme for theme in get_args(Theme) if theme == value), "dark")

    @theme.setter
    def theme(self, theme: Theme) -> None:
        self.setValue("theme", theme)

    @property
    def device(self) -> str:
        """Device that networks run on, unchecked; "auto" unless chosen."""
        return str(self.value("device", AUTO))

    @device.setter
    def device(self, device: str) -> None:
        self.setValue("device", device)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False
