"""The options of every command that opens one translation, said once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from pipeline.base.errors import SettingProblem
from pipeline.base.units import MeshUnit
from pipeline.recordings.formats import describe_formats

if TYPE_CHECKING:
    from pipeline.sensors.offsets import Offsets
    from pipeline.translation.translate import Request

Vector3 = Annotated[tuple[float, float, float], Parameter(negative="")]
RecordingPath = Annotated[Path, Parameter(help=f"File or folder: {describe_formats()}.")]
TargetName = Annotated[str, Parameter(help="Sensor to translate to.")]
StageSettings = Annotated[
    tuple[str, ...], Parameter(name="--set", negative="", help="`slot.parameter=value`, as often as needed.")
]
Flag = Annotated[bool, Parameter(negative="")]
DepthUnit = Annotated[
    Literal["auto", "mm", "m", "0.1mm", "um"],
    Parameter(help="Unit of a depth array or 16-bit picture whose name does not tell."),
]
ReferenceImagePath = Annotated[
    Path | None, Parameter(help="Image of the untouched sensor, where the recording holds none.")
]
_WEIGHTS = "File of a network's weights, for the method that takes such; `slot=FILE` where several do."
_METHODS = "`slot=method` in place of the route's own, such as `felt=reading`, as often as needed."


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TranslationOptions:
    """What goes with a recording.

    Parameters
    ----------
    sensor
        The sensor that made the recording, where the file does not say; also chooses one of several streams.
    stream
        Name of the stream, where one sensor has several.
    calibration
        Look-up made by `tactoscope calibrate balls`; the sensor's built-in one otherwise.
    route
        Way through the slots; each of them is filled by a method.
    mesh
        The touched object's mesh, for its pose.
    mesh_unit
        Unit of that mesh.
    alignment
        How the two sensors stand to each other, a .toml as `tactoscope align refine` writes it.
    shift_mm
        How far that alignment is moved: x, y and z in the target's frame.
    turn_deg
        How far it is turned: a rotation vector in the target's frame.
    pivot_mm
        The point in the target's frame that it is turned about.
    """

    sensor: str = ""
    stream: str = ""
    reference: ReferenceImagePath = None
    calibration: Path | None = None
    route: str = "t2d2"
    methods: Annotated[tuple[str, ...], Parameter(name="--method", negative="", help=_METHODS)] = ()
    mesh: Path | None = None
    mesh_unit: MeshUnit = "auto"
    depth_unit: DepthUnit = "auto"
    alignment: Path | None = None
    weights: Annotated[tuple[str, ...], Parameter(negative="", help=_WEIGHTS)] = ()
    translation_mm: Vector3 = (0.0, 0.0, 0.0)
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    pivot_mm: Vector3 = (0.0, 0.0, 0.0)

    def build_request(self, recording: Path, target: str) -> Request:
        """What is to be translated into what; raises SettingProblem for no slot=method, and for no offset in reach."""
        from pipeline.translation.catalogue import with_method, with_weights
        from pipeline.translation.translate import Request

        chosen: dict[str, str] = {}
        for assignment in self.methods:
            chosen = with_method(chosen, assignment)
        weights: dict[str, Path] = {}
        for assignment in self.weights:
            weights = with_weights(weights, assignment)
        return Request(
            recording=recording, target=target, source=self.sensor, stream=self.stream, route=self.route,
            methods=tuple(chosen.items()), reference=self.reference, calibration=self.calibration, mesh=self.mesh,
            mesh_unit=self.mesh_unit, depth_unit=self.depth_unit, alignment=self.alignment,
            weights=tuple(weights.items()),
            offsets=self._offsets(),
        )  # fmt: skip

    def _offsets(self) -> Offsets:
        from pipeline.sensors.offsets import parse_offsets

        moved = {"shift_mm": self.translation_mm, "turn_deg": self.rotation_deg, "pivot_mm": self.pivot_mm}
        try:
            return parse_offsets({name: list(three) for name, three in moved.items()})
        except ValueError as error:
            raise SettingProblem(f"--{str(error).replace('_', '-', 1)}") from None


DEFAULT_OPTIONS = TranslationOptions()


def split_list(listed: str) -> tuple[str, ...]:
    """The words of a list with commas."""
    return tuple(word for word in (part.strip() for part in listed.split(",")) if word)
