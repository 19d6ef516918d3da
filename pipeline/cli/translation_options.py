"""Options shared by all commands that open one translation."""

from __future__ import annotations

from contextlib import closing
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from pipeline.core.errors import SettingProblem, UnknownSensor
from pipeline.core.frozen import frozen
from pipeline.core.params import MeshUnit
from pipeline.io.formats import describe_formats

if TYPE_CHECKING:
    from pipeline.sensors.alignment import Offsets
    from pipeline.translation.translate import Request

Vector3 = Annotated[tuple[float, float, float], Parameter(negative="")]
RecordingPath = Annotated[Path, Parameter(help=f"File or folder: {describe_formats()}.")]
TargetName = Annotated[str, Parameter(help="Sensor to translate to.")]
StageSettings = Annotated[
    tuple[str, ...],
    Parameter(name="--set", negative="", help="`stage.parameter=value`; repeatable."),
]
Flag = Annotated[bool, Parameter(negative="")]
DepthUnit = Annotated[
    Literal["auto", "mm", "m", "0.1mm", "um"],
    Parameter(help="Unit of a depth array or 16-bit image whose file does not state it."),
]
ReferenceImagePath = Annotated[
    Path | None, Parameter(help="Reference image (no contact), if the recording holds none.")
]
ReferenceFrames = Annotated[
    str,
    Parameter(
        help="Make the reference of the recording's own frames: `median`, `untouched`, or a "
        "frame's number."
    ),
]
_WEIGHTS = "File of network weights; `stage=FILE` if several stages use a network."
_METHODS = (
    "`stage=method` in place of the route's own, such as `target_depth=paper`, or "
    "`depth=truth`; repeatable."
)


@Parameter(name="*")
@frozen
class TranslationOptions:
    """What a translation reads besides the recording.

    Args:
        sensor: Sensor that made the recording, if the file does not name it; also selects one of
            several streams.
        stream: Name of the stream, if one sensor has several.
        calibration: Calibration file made by `tactoscope calibrate`; default: the sensor's built-in
            table, force without scale.
        route: Route through the stages, which names a method for each: `object`, `t2d2` or `t2t`;
            default: `object` where the object's mesh is known, else `t2d2`.
        mesh: Mesh of the touched object, for its touch and pose.
        mesh_unit: Unit of that mesh.
        alignment: Alignment of the two sensors, a .toml as `tactoscope align refine` writes it.
        translation_mm: Translation added to the alignment: x, y and z in the target's frame.
        rotation_deg: Rotation added to the alignment: a rotation vector in the target's frame.
        pivot_mm: Centre of that rotation in the target's frame.
        device: Where networks run: auto (a card for those of published size), cpu, cuda, cuda:1 (of
            several) or mps.
    """

    sensor: str = ""
    stream: str = ""
    reference: ReferenceImagePath = None
    reference_frames: ReferenceFrames = ""
    calibration: Path | None = None
    route: str = ""
    methods: Annotated[tuple[str, ...], Parameter(name="--method", negative="", help=_METHODS)] = ()
    mesh: Path | None = None
    mesh_unit: MeshUnit = "auto"
    depth_unit: DepthUnit = "auto"
    alignment: Path | None = None
    weights: Annotated[tuple[str, ...], Parameter(negative="", help=_WEIGHTS)] = ()
    translation_mm: Vector3 = (0.0, 0.0, 0.0)
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    pivot_mm: Vector3 = (0.0, 0.0, 0.0)
    device: str = "auto"

    def build_request(self, recording: Path, target: str) -> Request:
        """The request of these options.

        Raises SettingProblem for a malformed `stage=method` or an offset too large.
        """
        from pipeline.translation.catalogue import with_method, with_weights
        from pipeline.translation.translate import Request

        methods = reduce(with_method, self.methods, dict[str, str]())
        weights = reduce(with_weights, self.weights, dict[str, Path]())
        return Request(
            recording=recording,
            target=target,
            source=self.sensor,
            stream=self.stream,
            route=self.route,
            methods=tuple(methods.items()),
            reference=self.reference,
            reference_frames=self.reference_frames,
            calibration=self.calibration,
            mesh=self.mesh,
            mesh_unit=self.mesh_unit,
            depth_unit=self.depth_unit,
            alignment=self.alignment,
            weights=tuple(weights.items()),
            refuses_unusable_weights=True,
            offsets=self._build_offsets(),
            device=self.device,
        )

    def _build_offsets(self) -> Offsets:
        from pipeline.core.typed_data import InvalidField, check
        from pipeline.sensors.alignment import Offsets

        vectors = {
            "translation_mm": self.translation_mm,
            "rotation_deg": self.rotation_deg,
            "pivot_mm": self.pivot_mm,
        }
        try:
            return check(vectors, Offsets)
        except InvalidField as error:
            raise SettingProblem(f"--{str(error).replace('_', '-', 1)}") from None


DEFAULT_OPTIONS = TranslationOptions()


def find_sensor(recording: Path, options: TranslationOptions) -> str:
    """The sensor that made the recording: the target where only the source's depth is computed.

    Raises UnknownSensor where neither the recording nor the options name it.
    """
    from pipeline.io import open_recording

    if options.sensor:
        return options.sensor
    with closing(
        open_recording(
            recording,
            stream=options.stream,
            depth_unit=options.depth_unit,
            reference=options.reference,
        )
    ) as opened:
        sensor = opened.stream(options.stream).sensor
    if not sensor:
        raise UnknownSensor(
            f"the recording does not say which sensor made it; choose one (--sensor): '{recording}'"
        )
    return sensor


def split_list(text: str) -> tuple[str, ...]:
    """The words of a comma-separated list, without blanks."""
    return tuple(word for word in (part.strip() for part in text.split(",")) if word)
