"""Live sources by name."""

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import Symmetry
from pipeline.core.params import check_range
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.io import image_files
from pipeline.io.live.foxglove_stream import FoxgloveSource
from pipeline.io.live.live_images import LiveImages, scale_depth
from pipeline.io.live.realsense import RealSenseSource
from pipeline.io.live.source import LiveFrame, LiveSource, LiveSourceLost
from pipeline.io.live.usb_camera import UsbCameraSource, is_address
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation import datasets
from pipeline.physics.simulation.datasets import SimulationPlan
from pipeline.sensors.spec import load_sensor

# of press, slide, twist, release; computed in the first cycle, then repeated with new noise
FRAMES_PER_CYCLE = 64
RATE_RANGE_HZ = (0.5, 120.0)
_MAX_WAIT_S = 0.2  # of one `read`
_LOOK_S = 0.002  # between looks at the sensor beside a simulated one


class SimulatedSource:
    """A simulated sensor with a fixed frame rate.

    The first cycle may be slower, since each frame is computed when due. Later a slow reader loses
    frames. A sensor `beside` another one is touched by the same object at the same moments.
    """

    def __init__(
        self,
        *,
        sensor: str = "gelslim",
        tool: str = "sphere",
        rate_hz: float = 15.0,
        seed: int = 0,
        beside: "SimulatedSource | None" = None,
    ) -> None:
        """Raises SettingProblem for an unknown sensor or object, or a rate out of range."""
        check_range("the rate", rate_hz, *RATE_RANGE_HZ, "Hz")
        like = SimulationPlan(
            sensors=(sensor,),
            object_source=tool,
            n_poses=FRAMES_PER_CYCLE,
            seed=seed,
            sequence="all",
        )
        self._plan = datasets.make_plans((tool,), like)[0]
        self._beside = beside
        if beside is not None:  # two sensors as far from the object as they are described
            self._plan = replace(beside._plan, sensors=(sensor,), bubble_deeper_mm=0.0)
            beside._plan = replace(beside._plan, bubble_deeper_mm=0.0)
        self.moment: tuple[int, float] | None = None  # number and time of the last one
        self._spec = load_sensor(sensor)
        self.rate_hz = rate_hz
        self._frames: dict[int, tuple[TactileFrame, Truth | None]] = {}
        self._noise = np.random.default_rng(seed)
        self._due_s = 0.0
        self._number = 0

    @property
    def title(self) -> str:
        """Name for people."""
        return f"simulated {self._spec.title}, {self._plan.object_name}"

    @property
    def sensor(self) -> str:
        """Name of its description."""
        return self._spec.name

    @property
    def touching_object(self) -> tuple[Mesh, Symmetry | None]:
        """Mesh and symmetry of the object that touches it."""
        return datasets.load_object_mesh(self._plan), datasets.load_object_symmetry(self._plan)

    def open(self) -> None:
        """Begin a cycle with the object clear of the sensor."""
        self._get_frame(0)  # compile and load before time counts
        self._due_s = time.monotonic()
        self._number = 0

    def read(self) -> LiveFrame | None:
        """The next frame of the cycle when due, or of the sensor beside this one, else None."""
        moment = self._wait_for_moment() if self._beside is None else self._beside.moment
        if moment is None or moment == self.moment:
            time.sleep(_LOOK_S)
            return None
        self.moment = moment
        number, time_s = moment
        frame, truth = self._get_frame(number % FRAMES_PER_CYCLE)
        image = frame.image if truth is None else self._render_image(truth)
        return LiveFrame(image=image, time_s=time_s, sequence_number=number, truth=truth)

    def _wait_for_moment(self) -> tuple[int, float] | None:
        """Number and time of the next moment that a slow reader has not missed."""
        wait_s = self._due_s - time.monotonic()
        if wait_s > 0:
            time.sleep(min(wait_s, _MAX_WAIT_S))
            if wait_s > _MAX_WAIT_S:
                return None
        if self._number % FRAMES_PER_CYCLE not in self._frames:
            self._get_frame(self._number % FRAMES_PER_CYCLE)
            self._due_s = time.monotonic()
        missed = max(0, int((time.monotonic() - self._due_s) * self.rate_hz))
        number = self._number + missed
        self._number, self._due_s = number + 1, self._due_s + (missed + 1) / self.rate_hz
        return number, time.monotonic()

    def close(self) -> None:
        """Nothing to release."""

    def _get_frame(self, index: int) -> tuple[TactileFrame, Truth | None]:
        if index not in self._frames:
            self._frames[index] = datasets.simulate_moment(self._plan, index)[0]
        return self._frames[index]

    def _render_image(self, truth: Truth) -> np.ndarray:
        """The image of the same touch with new noise."""
        assert truth.indentation_mm is not None
        depth = self._spec.rest_depth_mm - truth.indentation_mm.astype(np.float64)
        return render_sensor_image(
            self._spec, truth.indentation_mm, depth, int(self._noise.integers(1 << 31))
        )


_POLL_S = 0.05
_N_POLLS = 4  # before `read` returns None
_DAMAGED_AFTER_S = 2.0  # age of an unreadable image that counts as damaged, not as being written
_CLOCK_STEP_NS = 3_000_000_000  # of a file system's times; FAT has the largest, 2 s


class FolderSource:
    """Images of one size that appear after the source is opened."""

    touching_object = None  # not known

    def __init__(self, folder: Path, *, sensor: str = "") -> None:
        self._folder = folder
        self._images = LiveImages(sensor, may_differ=True)
        self._passed: set[str] = set()
        self._quiet_since_ns = -1  # the folder's time of change when a look found nothing new
        self._number = 0

    @property
    def title(self) -> str:
        """Name for people."""
        return f"images in {self._folder.name}"

    @property
    def sensor(self) -> str:
        """The stated sensor, or the one guessed from the first image's size; "" before."""
        return self._images.sensor

    def open(self) -> None:
        """List the images that are there; raises LiveSourceLost without the folder."""
        if not self._folder.is_dir():
            raise LiveSourceLost(f"there is no folder '{self._folder}'; trying again")
        if not self._passed:
            self._passed = {name for name, _ in self._list_new_images()}

    def read(self) -> LiveFrame | None:
        """The newest complete image; older new ones count as lost. None if none came."""
        for _ in range(_N_POLLS):
            new = self._list_new_images()
            for n_newer, (name, taken_s) in enumerate(reversed(new)):
                raw = self._read_image(self._folder / name, taken_s)
                if raw is not None:
                    self._passed |= {old for old, _ in new[: len(new) - n_newer]}
                    self._number += len(new) - n_newer
                    is_depth = raw.ndim == 2
                    return LiveFrame(
                        image=raw if is_depth else self._images.convert_image(raw),
                        camera=self._images.find_camera(raw) if is_depth else None,
                        time_s=time.monotonic(),
                        sequence_number=self._number,
                    )
            time.sleep(_POLL_S)
        return None

    def close(self) -> None:
        """Nothing to release."""

    def _list_new_images(self) -> list[tuple[str, float]]:
        """(name, time written in s) of the images that were not passed, oldest first.

        Listing 50,000 names takes 25 ms, so a folder that has not changed since nothing was new is
        not listed.
        """
        looked_ns = time.time_ns()
        try:
            changed_ns = self._folder.stat().st_mtime_ns
            if changed_ns == self._quiet_since_ns:
                return []
            with os.scandir(self._folder) as entries:
                found = [
                    (e.stat().st_mtime_ns, e.name)
                    for e in entries
                    if e.name not in self._passed
                    and e.is_file()
                    and image_files.is_image_file(Path(e.name))
                ]
        except OSError:
            raise LiveSourceLost(f"the folder '{self._folder}' is gone; trying again") from None
        if not found and looked_ns - changed_ns > _CLOCK_STEP_NS:
            self._quiet_since_ns = changed_ns
        return [(name, written_ns * 1e-9) for written_ns, name in sorted(found)]

    def _read_image(self, path: Path, written_s: float) -> np.ndarray | None:
        """The image, or depth in mm of one of 16 bits; None while it is written, and for one that
        is damaged or of another size, which is skipped.
        """
        try:
            raw = image_files.read_raw_pixels(path)
        except FileProblem:
            if time.time() - written_s > _DAMAGED_AFTER_S:
                self._passed.add(path.name)
            return None
        is_depth = raw.dtype == np.uint16 and raw.ndim == 2
        read = scale_depth(raw) if is_depth else image_files.to_rgb(raw, path)
        if self._images.shape not in ((), read.shape):
            self._passed.add(path.name)
            return None
        return read


DEFAULT_SENSOR = "gelslim"  # of the simulated source


def parse_source(
    words: Sequence[str], *, sensor: str = "", tool: str = "sphere", rate_hz: float = 15.0
) -> LiveSource:
    """The source for words or one text as `tactoscope live --source` takes them.

    Raises SettingProblem.
    """
    check_range("the rate", rate_hz, *RATE_RANGE_HZ, "Hz")
    if sensor:
        sensor = sensor if sensor.endswith(".toml") else load_sensor(sensor).name
    match _split(words):
        case ["simulated"]:
            return SimulatedSource(sensor=sensor or DEFAULT_SENSOR, tool=tool, rate_hz=rate_hz)
        case ["folder", name]:
            return FolderSource(Path(name), sensor=sensor)
        case ["device", name]:
            return UsbCameraSource(name, sensor=sensor)
        case [name] if is_address(name) or (name.startswith("camera:") and name != "camera:"):
            return UsbCameraSource(name.removeprefix("camera:"), sensor=sensor)
        case [name, *topic] if name.startswith(("ws://", "wss://")) and len(topic) < 2:
            return FoxgloveSource(name, *topic, sensor=sensor)
        case ["realsense", *serial] if len(serial) < 2:
            return RealSenseSource(*serial, sensor=sensor)
        case _:
            kinds = (
                "simulated, folder DIR, device NAME, camera:0, http://..., rtsp://..., "
                "realsense [SERIAL] or ws://HOST:PORT TOPIC"
            )
            raise SettingProblem(f"a source is {kinds}, got {' '.join(words)!r}")


def parse_sources(
    words: Sequence[str],
    partner: Sequence[str],
    *,
    sensor: str = "",
    partner_sensor: str = "",
    target: str = "",
    tool: str = "sphere",
    rate_hz: float = 15.0,
) -> tuple[LiveSource, LiveSource | None]:
    """The source, and the sensor beside it, whose words are none or such as those of a source.

    A partner whose sensor is not given is the target's: its images are the truth. Raises
    SettingProblem.
    """
    source = parse_source(words, sensor=sensor, tool=tool, rate_hz=rate_hz)
    if not any(partner):
        return source, None
    beside = partner_sensor or target
    if target and load_sensor(beside).name not in (load_sensor(target).name, source.sensor):
        raise SettingProblem(
            f"a partner of {beside} is no truth of {target}; give --target {beside}, or the "
            "target's own sensor as partner"
        )
    if _split(partner) == ["simulated"]:
        if not isinstance(source, SimulatedSource):
            raise SettingProblem(
                "a simulated partner does not touch what a real source touches; give both real or "
                "both simulated"
            )
        return source, SimulatedSource(sensor=beside or source.sensor, beside=source)
    if _split(partner) == _split(words):
        raise SettingProblem(
            f"source and partner are both {' '.join(words)!r}; name the other sensor as partner"
        )
    return source, parse_source(partner, sensor=beside)


def _split(words: Sequence[str]) -> list[str]:
    return words[0].split(maxsplit=1) if len(words) == 1 else list(words)
