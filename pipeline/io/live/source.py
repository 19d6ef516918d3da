"""Live sources: sensors that are opened, read, lost and opened again."""

import math
from typing import Protocol

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import TouchError
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import Symmetry
from pipeline.core.values.frames import Truth


class LiveSourceLost(TouchError):
    """The sensor is not connected; the reader tries again until it is stopped."""


@frozen
class LiveFrame:
    """One image of a live source."""

    image: Image | Floats  # of the sensor's size
    time_s: float  # of the monotonic clock, when taken
    sequence_number: int = -1  # of the sensor, whose gaps are lost frames; -1 = not counted
    stamp_s: float = math.nan  # of the sensor's own clock, which may jump; NaN = none
    # intrinsics that came with the image; None = those of the sensor's description
    camera: Camera | None = None
    truth: Truth | None = None  # of a simulated touch


class LiveSource(Protocol):
    """A live sensor; used by one thread at a time."""

    @property
    def title(self) -> str:
        """Name for people."""
        ...

    @property
    def sensor(self) -> str:
        """Name of its description."""
        ...

    @property
    def touching_object(self) -> tuple[Mesh, Symmetry | None] | None:
        """Mesh and symmetry of the object that touches it, known of simulated sensors.

        Else None.
        """
        ...

    def open(self) -> None:
        """Connect; raises LiveSourceLost."""
        ...

    def read(self) -> LiveFrame | None:
        """The next image, None after a fifth of a second without one; raises LiveSourceLost."""
        ...

    def close(self) -> None:
        """Disconnect; may be opened again."""
        ...
