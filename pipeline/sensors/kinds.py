"""Kinds of sensors: a `SensorKind` knows how sensors of a kind are described and what they record.

What other parts of the pipeline do for each kind (depth, render, press, force, networks) is a
`KindTable` beside the code that does it, so that imports point down. A third kind is a subclass and
its entries in those tables, in one module: `tests/pipeline/sensors/test_third_kind.py` is one.
Another package adds its kind by the entry point group `tactoscope.sensor_kinds`, whose value is a
`SensorKind`, or by `register_kind`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats
from pipeline.core.entry_points import load_entry_points
from pipeline.core.frozen import frozen
from pipeline.core.geometry import membrane
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.membrane import Membrane
from pipeline.sensors.descriptions import DescriptionSection
from pipeline.sensors.parts import Bubble, DepthCamera, Gel, parse_optics, parse_part

V = TypeVar("V")
GetSection = Callable[[str], DescriptionSection]
DisplayGroup = Literal["gel", "bubble"]

_BLACK_GREY = 2  # grey level; no lit gel is this dark everywhere
# grey level; no gel is this bright everywhere, noise takes clipped pixels down to here
_WHITE_GREY = 254


@frozen
class SensorKind(ABC):
    """One kind of sensor: how it is described, and what it records."""

    key: str  # `kind` of a sensor description
    # frames are depth images (rows, cols) float32 mm; else RGB images (rows, cols, 3) uint8
    is_depth: bool
    change_sign: float  # 1: change is image - reference; -1: reference - image, an imprint
    full_change: float  # change that networks see as 1: 255 grey levels, or 1 mm
    peak_change: float  # largest change of an image, in grey levels or mm, for PSNR and SSIM
    display_group: DisplayGroup  # display settings and scales that apply
    still_change: float  # grey levels or mm that the mean of a block may change without contact
    # mm by which a block's mean may drift; None = `limits.no_contact_change` of the sensor
    drift_change: float | None

    @property
    def change_unit(self) -> str:
        """Unit of changes, as sensor descriptions write it."""
        return "mm" if self.is_depth else "grey"

    @abstractmethod
    def parse_parts(
        self, section: GetSection, data: dict[str, Any], path: Path, /
    ) -> dict[str, Any]:
        """Return the fields of SensorSpec that this kind describes; raises CalibrationError."""

    @abstractmethod
    def parse_membrane(
        self, section: GetSection, camera: Camera, parts: dict[str, Any], /
    ) -> Membrane:
        """Return the membrane of the description; raises CalibrationError."""

    @abstractmethod
    def find_image_problem(self, image: NDArray[Any]) -> str:
        """Return why an image cannot be used, as a clause; "" where it can."""

    def compute_change(self, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
        """The change float32 by contact, of the images' shape, in grey levels or mm (positive =
        pressed in).
        """
        return np.float32(self.change_sign) * (
            image.astype(np.float32) - reference.astype(np.float32)
        )

    def compute_relative_change(self, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
        """The change (rows, cols, channels) as networks see it, in units of `full_change`.

        0 if not measured.
        """
        share = self.compute_change(image, reference) / np.float32(self.full_change)
        return np.nan_to_num(np.atleast_3d(share), nan=0.0, posinf=0.0, neginf=0.0)

    def apply_change(self, reference: NDArray[Any], change: NDArray[Any]) -> NDArray[Any]:
        """The image of this change; inverse of `compute_change`."""
        image = reference + np.float32(self.change_sign) * change
        return (
            image.astype(np.float32)
            if self.is_depth
            else np.clip(np.rint(image), 0, 255).astype(np.uint8)
        )


class GelSensor(SensorKind):
    """A camera watches the coloured light on an elastic layer."""

    __slots__ = ()

    def parse_parts(
        self, section: GetSection, data: dict[str, Any], path: Path, /
    ) -> dict[str, Any]:
        """Return the fields of [gel] and [optics]."""
        return {
            "gel": parse_part(Gel, section("gel")),
            "optics": parse_optics(section("optics"), data, path),
        }

    def parse_membrane(
        self, section: GetSection, camera: Camera, _parts: dict[str, Any], /
    ) -> Membrane:
        """Return a flat membrane at the depth of [rest] that fills the image."""
        z_mm = section("rest").read_number("depth", "mm", 0.1, 1000.0)
        return membrane.make_flat_membrane(
            z_mm, camera.cols * z_mm / camera.fx_px, camera.rows * z_mm / camera.fy_px
        )

    def find_image_problem(self, image: NDArray[Any]) -> str:
        """Return why an image (rows, cols, 3) cannot be used, as a clause; "" where it can."""
        if image.dtype != np.uint8:
            is_nan = np.issubdtype(image.dtype, np.floating) and not np.isfinite(image).all()
            what = "holds values that are not numbers (NaN)" if is_nan else f"is {image.dtype}"
            return f"{what}; a gel's image must be RGB of 8 bits"
        if int(image.max()) <= _BLACK_GREY:
            return "is black; check the light and the camera, or leave this frame out"
        if int(image.min()) >= _WHITE_GREY:
            return (
                "is clipped in every pixel and shows nothing of the gel; reduce the exposure, "
                "or leave this frame out"
            )
        return ""


class BubbleSensor(SensorKind):
    """A depth camera watches an inflated membrane."""

    __slots__ = ()

    def parse_parts(
        self, section: GetSection, data: dict[str, Any], _path: Path, /
    ) -> dict[str, Any]:
        """Return the fields of [bubble] and [depth_camera]."""
        depth_camera = (
            parse_part(DepthCamera, section("depth_camera"))
            if "depth_camera" in data
            else DepthCamera()
        )
        return {"bubble": parse_part(Bubble, section("bubble")), "depth_camera": depth_camera}

    def parse_membrane(
        self, section: GetSection, _camera: Camera, parts: dict[str, Any], /
    ) -> Membrane:
        """Return a dome over the rim at the depth of [rest]."""
        bubble: Bubble = parts["bubble"]
        rim_mm = section("rest").read_number("rim_depth", "mm", 1.0, 1000.0)
        return membrane.make_dome_membrane(
            rim_mm, bubble.height_mm, bubble.half_width_mm, bubble.half_height_mm
        )

    def find_image_problem(self, image: NDArray[Any]) -> str:
        """Return why a depth image (rows, cols) cannot be used, as a clause; "" where it can."""
        if not np.issubdtype(image.dtype, np.floating):
            return f"is {image.dtype}; a bubble's depth must be float32 in millimetres"
        if not (image > 0).any():
            return "holds no depth at all (NaN or zero everywhere); leave this frame out"
        return ""


class KindTable(Generic[V]):
    """What a part of the pipeline does for each kind of sensor.

    A subclass without an entry has that of its base.
    """

    def __init__(self, entries: Mapping[type[SensorKind], V]) -> None:
        """Hold the entries of the project's own kinds."""
        self._entries = dict(entries)

    def add(self, kind: type[SensorKind], entry: V) -> None:
        """Add the entry of another kind, for this process."""
        self._entries[kind] = entry

    def get(self, kind: SensorKind) -> V | None:
        """Return the entry of a kind; None if it has none."""
        return next(
            (self._entries[base] for base in type(kind).__mro__ if base in self._entries), None
        )


GEL = GelSensor(
    key="gel",
    is_depth=False,
    change_sign=1.0,
    full_change=255.0,
    peak_change=255.0,
    display_group="gel",
    still_change=2.0,
    drift_change=None,
)
BUBBLE = BubbleSensor(
    key="bubble",
    is_depth=True,
    change_sign=-1.0,
    full_change=1.0,
    peak_change=22.5,  # mm, as published
    display_group="bubble",
    still_change=0.4,
    drift_change=1.0,
)
_registered: dict[str, SensorKind] = {}


def register_kind(kind: SensorKind) -> None:
    """Add a kind for this process."""
    _registered[kind.key] = kind


def list_kinds() -> dict[str, SensorKind]:
    """Key -> kind; those of the project cannot be replaced."""
    kinds = [
        *load_entry_points("tactoscope.sensor_kinds", SensorKind),
        *_registered.values(),
        GEL,
        BUBBLE,
    ]
    return {kind.key: kind for kind in kinds}


def get_kind(key: str) -> SensorKind:
    """The kind of this key."""
    return list_kinds()[key]
