"""What comes in: a frame of a tactile sensor, what is known to be true of it, and recordings of both."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.base.arrays import Doubles, Floats, Image, Mask
from pipeline.base.errors import SettingProblem
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.geometry.meshes import Mesh

if TYPE_CHECKING:  # the shapes are many, and a recording needs none of them
    from pipeline.geometry.symmetry import Symmetry


@dataclass(frozen=True, slots=True, kw_only=True)
class TactileFrame:
    """One reading of one sensor, with the untouched reading that it is compared to."""

    sensor: str
    image: Image | Floats  # (rows, cols, 3) uint8 RGB, or (rows, cols) float32 depth in mm, NaN = no reading
    reference: Image | Floats | None  # the same sensor untouched, same shape and type; None = not recorded
    index: int = 0
    time_s: float = math.nan
    origin: str = ""  # where it was read from, for messages
    camera: Camera | None = None  # intrinsics that the recording brings along; None = the sensor's own
    context_frames: tuple[
        Image, ...
    ] = ()  # other touches of the same unit, with the same reference: they tell of its light

    @property
    def is_depth(self) -> bool:
        """Whether the reading is a depth image (a bubble) rather than a colour image (a gel)."""
        return self.image.ndim == 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What is exactly known of a frame, in its own sensor's frame; None where it is not known."""

    indentation_mm: Floats | None = None  # (rows, cols)
    contact: Mask | None = None  # (rows, cols) pressure > 0
    sensor_from_object: Doubles | None = None  # (4, 4) mm
    force_n: Doubles | None = None  # (3,) on the sensor: right, down, and away from the camera, so that a press is < 0


def _no_truth(_index: int) -> Truth | None:
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """The frames of one sensor; nothing is read before it is asked for."""

    name: str  # unique in its recording, such as "gelslim" or "left"
    sensor: str  # a sensor of `pipeline.sensors`; "" = the file does not say
    n_frames: int
    frame: Callable[[int], TactileFrame]  # raises FileProblem naming file, frame and field
    truth: Callable[[int], Truth | None] = _no_truth
    has_truth: bool = False


def _nothing() -> None:
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairing:
    """How two streams of one recording stand to each other, where the recording knows it."""

    source: str  # name of a stream
    target: str
    target_from_source: Doubles  # (4, 4) mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """One or several sensors over the same touches: frame `i` of each stream is the same moment."""

    path: Path
    format: str  # words for the user: "tactoscope recording", "folder of images", ...
    streams: tuple[Stream, ...]
    object_mesh: Mesh | None = None
    pairings: tuple[Pairing, ...] = ()
    notes: tuple[str, ...] = field(default=())  # plain sentences: what was assumed, converted or left out
    close: Callable[[], None] = _nothing
    symmetry: Symmetry | None = None  # of the object; None = not known, so that no two of its poses count as one
    refresh: Callable[[], Recording] | None = None  # the same with what has come since; None = nothing comes any more

    def stream(self, wanted: str = "") -> Stream:
        """The stream with this name or sensor, the first one when `wanted` is empty."""
        for stream in self.streams:
            if wanted in ("", stream.name, stream.sensor):
                return stream
        names = ", ".join(sorted(f"{s.name!r}" for s in self.streams))
        raise SettingProblem(f"no stream {wanted!r} in this recording; it has {names}")

    def stream_of_sensor(self, sensor: str) -> Stream | None:
        """The stream that `sensor` recorded, None if it took no part."""
        return next((s for s in self.streams if s.sensor == sensor), None)

    def target_from_source(self, source: str, target: str) -> Doubles | None:
        """The transform between two streams by name, either way round; None where the recording does not know it."""
        for pair in self.pairings:
            if (pair.source, pair.target) == (source, target):
                return pair.target_from_source
            if (pair.source, pair.target) == (target, source):
                return rigid.invert(pair.target_from_source)
        return None
