"""Kinds of sensors: one `SensorKind` holds all that the pipeline does differently for a gel and for a bubble.

Another package adds a kind by the entry point group `tactoscope.sensor_kinds`, whose value is a `SensorKind`, or by
`register_kind`. Functions are named as "module:function" and imported on first use, since most of them belong to upper
layers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats
from pipeline.base.entry_points import load_entry_points, load_reference
from pipeline.geometry.camera import Camera
from pipeline.geometry.membrane import Membrane
from pipeline.sensors.descriptions import DescriptionSection

GetSection = Callable[[str], DescriptionSection]
DisplayGroup = Literal["gel", "bubble"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorKind:
    """One kind of sensor: how it is described, what it records, and which functions compute for it."""

    key: str  # `kind` of a sensor description
    is_depth: bool  # frames are depth images (rows, cols) float32 mm; else RGB images (rows, cols, 3) uint8
    change_sign: float  # 1: change is image - reference; -1: reference - image, an imprint
    full_change: float  # change that networks see as 1: 255 grey levels, or 1 mm
    peak_change: float  # largest change of an image, in grey levels or mm, for PSNR and SSIM
    display_group: DisplayGroup  # display settings and scales that apply
    still_change: float  # grey levels or mm that the mean of a block may change without contact
    drift_change: float | None  # mm by which a block's mean may drift; None = `limits.no_contact_change` of the sensor
    part_parser: str  # (GetSection, data, path) -> fields of SensorSpec
    membrane_parser: str  # (GetSection, Camera, parsed parts) -> Membrane, where [rest] gives no mesh
    reference_renderer: str  # (SensorSpec) -> image without contact and noise
    image_checker: str  # (image) -> what is wrong with it as a clause, "" = nothing
    contact_checker: str  # (frame, sensor, calibration, limit) -> notes without contact, None = maybe contact
    depth_estimator: str  # (frame, SensorSpec, Calibration | None, DepthParams, Progress) -> DepthMap; "" = as a gel
    touch_renderer: str = ""  # of the physical render; "" = the kind cannot be a target of it
    press_simulator: str = ""  # of the simulator; "" = the kind is not simulated
    image_simulator: str = ""
    force_estimator: str = ""  # (SensorSpec, frame, indentation_mm, contact) -> ContactForce; "" = no model
    touch_format: str = ""  # `networks.touch_formats.TouchFormat`; "" = networks of touches do not know the kind

    @property
    def change_unit(self) -> str:
        """Unit of changes, as sensor descriptions write it."""
        return "mm" if self.is_depth else "grey"

    def parse_parts(self, section: GetSection, data: dict[str, Any], path: Path) -> dict[str, Any]:
        """The fields of SensorSpec that this kind describes; raises CalibrationError."""
        return load_reference(self.part_parser)(section, data, path)

    def parse_membrane(self, section: GetSection, camera: Camera, parts: dict[str, Any]) -> Membrane:
        """The membrane that the description gives as numbers; raises CalibrationError."""
        return load_reference(self.membrane_parser)(section, camera, parts)

    def render_reference(self, sensor: Any) -> NDArray[Any]:
        """The image of a sensor (SensorSpec) without contact and noise."""
        return load_reference(self.reference_renderer)(sensor)

    def simulate_image(
        self,
        sensor: Any,
        indentation_mm: Floats,
        depth_mm: NDArray[Any],
        seed: int | None,
        shear_mm: Floats | None = None,
    ) -> NDArray[Any]:
        """The image of a membrane (rows, cols) at `depth_mm`, `indentation_mm` from rest, with noise if seeded."""
        return load_reference(self.image_simulator)(sensor, indentation_mm, depth_mm, seed, shear_mm)

    def compute_change(self, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
        """The change float32 by contact, of the images' shape, in grey levels or mm (positive = pressed in)."""
        return np.float32(self.change_sign) * (image.astype(np.float32) - reference.astype(np.float32))

    def compute_relative_change(self, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
        """The change (rows, cols, channels) as networks see it, in units of `full_change`; 0 if not measured."""
        share = self.compute_change(image, reference) / np.float32(self.full_change)
        return np.nan_to_num(np.atleast_3d(share), nan=0.0, posinf=0.0, neginf=0.0)

    def apply_change(self, reference: NDArray[Any], change: NDArray[Any]) -> NDArray[Any]:
        """The image of this change; inverse of `compute_change`."""
        image = reference + np.float32(self.change_sign) * change
        return image.astype(np.float32) if self.is_depth else np.clip(np.rint(image), 0, 255).astype(np.uint8)


_BUILT_IN = ("pipeline.sensors.gel_kind:GEL", "pipeline.sensors.bubble_kind:BUBBLE")
_registered: dict[str, SensorKind] = {}


def register_kind(kind: SensorKind) -> None:
    """Add a kind for this process."""
    _registered[kind.key] = kind


def list_kinds() -> dict[str, SensorKind]:
    """Key -> kind; those of the project cannot be replaced."""
    kinds = [
        *load_entry_points("tactoscope.sensor_kinds", SensorKind),
        *_registered.values(),
        *map(load_reference, _BUILT_IN),
    ]
    return {kind.key: kind for kind in kinds}


def get_kind(key: str) -> SensorKind:
    """The kind of this key."""
    return list_kinds()[key]
