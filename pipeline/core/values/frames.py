"""Input values: frames of tactile sensors, their ground truth, and recordings of both."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.core.arrays import Doubles, Floats, Image, Mask
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh

if TYPE_CHECKING:  # imported on use
    from pipeline.core.geometry.symmetry import Symmetry


@frozen
class TactileFrame:
    """One frame of one sensor with its reference."""

    sensor: str
    # (rows, cols, 3) uint8 RGB, or (rows, cols) float32 depth in mm, NaN = no value
    image: Image | Floats
    # the sensor without contact, same shape and type; None = not recorded
    reference: Image | Floats | None
    index: int = 0
    time_s: float = math.nan
    origin: str = ""  # file and frame, for messages
    camera: Camera | None = None  # intrinsics of the recording; None = the sensor's
    # least and largest value in all fingers; None = one finger
    grasp_range: tuple[float, float] | None = None
    # other touches of the same instance, to estimate its illumination
    context_frames: tuple[Image, ...] = ()
    # what the file holds where `image` was restored from it (a difference)
    stored_image: Image | None = None

    @property
    def shown_image(self) -> Image | Floats:
        """The image as recorded, to be shown as such."""
        return self.image if self.stored_image is None else self.stored_image

    @property
    def is_depth(self) -> bool:
        """Whether the image is a depth image (of a bubble) and not RGB (of a gel)."""
        return self.image.ndim == 2


@frozen
class Truth:
    """Ground truth of a frame in its sensor's frame; None = not known."""

    indentation_mm: Floats | None = None  # (rows, cols)
    contact: Mask | None = None  # (rows, cols) pressure > 0
    sensor_from_object: Doubles | None = None  # (4, 4) mm
    # (4, 4) mm, to the frame between two fingers, x along their closing
    grasp_from_sensor: Doubles | None = None
    # (3,) on the sensor: right, down, away from the camera (a press is < 0)
    force_n: Doubles | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stream:
    """The frames of one sensor, read on demand."""

    name: str  # unique in its recording, such as "gelslim" or "left"
    sensor: str  # name of a sensor description; "" = not known
    n_frames: int
    frame: Callable[[int], TactileFrame]  # raises FileProblem naming file, frame and field
    truth: Callable[[int], Truth | None] = lambda _i: None
    has_truth: bool = False
    # (n_frames,) by the recording's clock, NaN = unknown; None = no frame has a time
    times_s: Doubles | None = None


@frozen
class Pairing:
    """The known transform between two streams of one recording."""

    source: str  # name of a stream
    target: str
    target_from_source: Doubles  # (4, 4) mm


@frozen
class Grasp:
    """What a data set says about one of its grasps."""

    tool: str = ""  # name of the object; "" = not known
    split: str = ""  # folder or list of the data set that it belongs to, such as "train"; "" = none
    number: int = 0
    mesh_file: Path | None = None  # of the tool, in metres; None = not there

    @property
    def name(self) -> str:
        """Tool and number, and the split where there is one."""
        return " ".join(
            part
            for part in (self.tool, str(self.number), f"({self.split})" if self.split else "")
            if part
        )


@frozen
class Recording:
    """One or several sensors that record the same touches.

    `pairing` tells which frames are one moment.
    """

    path: Path
    format: str  # for people: "tactoscope recording", "folder of images", ...
    streams: tuple[Stream, ...]
    object_mesh: Mesh | None = None
    pairings: tuple[Pairing, ...] = ()
    notes: tuple[str, ...] = field(default=())  # sentences: what was assumed, converted or left out
    close: Callable[[], None] = lambda: None
    symmetry: Symmetry | None = None  # of the object; None = not known, and no poses count as equal
    # the recording with frames that came since; None = it does not grow
    refresh: Callable[[], Recording] | None = None
    alternatives: tuple[Path, ...] = ()  # the recordings of the same folder, where it holds several
    grasps: tuple[Grasp, ...] = ()  # one per frame index; () = the data set names none
    # why its frames are not of one touch; "" = fine
    find_pair_problem: Callable[[int], str] = lambda _i: ""

    def __repr__(self) -> str:
        streams = ", ".join(f"{s.n_frames} frames of {s.name}" for s in self.streams)
        return f"<{self.format} {self.path.name!r}: {streams}>"

    def stream(self, name_or_sensor: str = "") -> Stream:
        """The stream with this name, else the first of this sensor, the first one for "".

        Raises SettingProblem.
        """
        wanted = name_or_sensor.strip("/")  # as topics are written
        named = [s for s in self.streams if s.name == wanted]
        for stream in named or self.streams:
            if name_or_sensor in ("", stream.sensor) or stream in named:
                return stream
        names = ", ".join(
            sorted(f"{s.name!r}{f' of {s.sensor}' if s.sensor else ''}" for s in self.streams)
        )
        raise SettingProblem(
            f"no stream {name_or_sensor!r} in this recording; it has {names}; choose one with "
            "--stream"
        )

    def stream_of_sensor(self, sensor: str) -> Stream | None:
        """The stream of a sensor, else None."""
        return next((s for s in self.streams if s.sensor == sensor), None)

    def find_partner(self, stream: str, sensor: str) -> Stream | None:
        """The stream of a sensor that records the touches of another stream: its pair, else the
        sensor's first.
        """
        paired = {pair.target for pair in self.pairings if pair.source == stream}
        paired |= {pair.source for pair in self.pairings if pair.target == stream}
        found = next((s for s in self.streams if s.sensor == sensor and s.name in paired), None)
        return found or self.stream_of_sensor(sensor)

    def target_from_source(self, source: str, target: str) -> Doubles | None:
        """The transform (4, 4) in mm between two streams by name, in either direction.

        None if not known.
        """
        for pair in self.pairings:
            if (pair.source, pair.target) == (source, target):
                return pair.target_from_source
            if (pair.source, pair.target) == (target, source):
                return rigid.invert(pair.target_from_source)
        return None
