"""What a user can be told went wrong: one sentence of what, where and what to try."""

from __future__ import annotations

from pathlib import Path


class TouchError(Exception):
    """Root of every error that is the user's to mend; its text is shown as it is, never as a traceback."""


class FileProblem(TouchError):
    """A file is missing, damaged, or not what it says; `path` names it, `field` the part of it."""

    def __init__(self, what: str, path: Path | str, *, field: str | None = None) -> None:
        """Build the sentence `what: 'path'`, with the path last so that it can be cut off."""
        self.path = Path(path)
        self.field = field
        super().__init__(f"{what}: '{path}'")


class ShapeError(TouchError):
    """An array has another shape, type or content than the stage needs."""


class CalibrationError(TouchError):
    """A sensor description, look-up, intrinsic matrix or alignment cannot be used."""


class SettingProblem(TouchError):
    """A parameter, sensor, route or option does not exist or is out of its range."""


class MeshProblem(TouchError):
    """An object mesh is empty, damaged, or in a unit that cannot be right."""


class NotConverged(TouchError):
    """An iterative solve ended without an answer that it can vouch for."""
