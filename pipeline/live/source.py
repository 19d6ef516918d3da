"""What a sensor that is there now looks like to the program: it is opened, read, lost and found again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from pipeline.base.arrays import Floats, Image
from pipeline.base.errors import TouchError
from pipeline.geometry.meshes import Mesh
from pipeline.geometry.symmetry import Symmetry
from pipeline.values.frames import Truth


class LiveSourceLost(TouchError):
    """The sensor is not there, or not there any more; it is tried again until somebody stops."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveFrame:
    """One picture as it came."""

    image: Image | Floats  # of the sensor's own size
    time_s: float  # monotonic clock, when it was taken
    sequence_number: int = -1  # counted by the sensor, so that gaps are frames that were lost; -1 = it does not count
    truth: Truth | None = None  # of a simulated touch


class LiveSource(Protocol):
    """A sensor; used by one thread at a time."""

    @property
    def title(self) -> str:
        """What it is, in words."""
        ...

    @property
    def sensor(self) -> str:
        """Its description's name."""
        ...

    @property
    def touching_object(self) -> tuple[Mesh, Symmetry | None] | None:
        """The object that touches it, where that is known: a simulated one's."""
        ...

    def open(self) -> None:
        """Begin; raises SourceLost where it is not there."""
        ...

    def read(self) -> LiveFrame | None:
        """The next picture, None if none came within a fifth of a second; raises SourceLost once it is gone."""
        ...

    def close(self) -> None:
        """Let go of it; may be opened again."""
        ...
