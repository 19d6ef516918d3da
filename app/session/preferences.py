"""What the program remembers between two starts, for all sessions: where windows were and what was opened last."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, cast, get_args

from PyQt6.QtCore import QByteArray, QSettings

Theme = Literal["light", "dark", "system"]
_MOST_RECENT = 12
_LAYOUT = 2  # counts up when docks or tool bars change their names, so that an old arrangement is not forced on them


class Preferences:
    """The program's own settings file; nothing scientific is in it."""

    def __init__(self) -> None:
        kind, scope = QSettings.Format.IniFormat, QSettings.Scope.UserScope
        self._kept = QSettings(kind, scope, "Tactoscope", "Tactoscope")

    @property
    def recent_files(self) -> tuple[Path, ...]:
        """What was opened, the latest first, as far as it is still there."""
        said: object = self._kept.value("recent", [])
        names = cast("Sequence[object]", [said] if isinstance(said, str) else said or [])
        paths = [Path(name) for name in names if isinstance(name, str)]
        return tuple(path for path in paths if _is_there(path))

    def add_recent(self, path: Path) -> None:
        """Put `path` first among the recent ones, and remember its folder."""
        path = path.absolute()
        others = [str(old) for old in self.recent_files if old != path]
        self._kept.setValue("recent", [str(path), *others][:_MOST_RECENT])
        self.last_folder = path.parent

    def clear_recent(self) -> None:
        """Empty the list."""
        self._kept.remove("recent")

    @property
    def last_folder(self) -> Path | None:
        """Where a file was chosen last; None if that is gone."""
        path = Path(str(self._kept.value("folder", "")))
        return path if path.name and _is_there(path) else None

    @last_folder.setter
    def last_folder(self, path: Path) -> None:
        self._kept.setValue("folder", str(path))

    @property
    def window_geometry(self) -> tuple[QByteArray, QByteArray] | None:
        """(geometry, arrangement) of the last window, as Qt tells them; None where there is none of this layout."""
        geometry, state = (self._kept.value(f"window{_LAYOUT}/{key}") for key in ("geometry", "state"))
        return (geometry, state) if isinstance(geometry, QByteArray) and isinstance(state, QByteArray) else None

    @window_geometry.setter
    def window_geometry(self, place: tuple[QByteArray, QByteArray]) -> None:
        for key, value in zip(("geometry", "state"), place, strict=True):
            self._kept.setValue(f"window{_LAYOUT}/{key}", value)

    @property
    def settings_folder(self) -> Path:
        """Where the settings lie, for what is too large to be one of them."""
        return Path(self._kept.fileName()).parent

    @property
    def theme(self) -> Theme:
        """How the window is coloured; the system's where nothing was chosen."""
        said: object = self._kept.value("theme", "system")
        return next((theme for theme in get_args(Theme) if theme == said), "system")

    @theme.setter
    def theme(self, theme: Theme) -> None:
        self._kept.setValue("theme", theme)

    def write(self) -> None:
        """Bring it to disk now."""
        self._kept.sync()


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False
