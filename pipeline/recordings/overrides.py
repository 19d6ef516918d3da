"""Sensor and reference that the user states in place of what the file says."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pipeline.base.arrays import Floats, Image
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.sensors.spec import load_sensor
from pipeline.values.frames import Recording, Stream, TactileFrame


def with_sensor(recording: Recording, sensor: str) -> Recording:
    """The recording with `sensor` as the sensor of its only stream, or of the streams that do not name theirs."""
    if not sensor:
        return recording
    name = load_sensor(sensor).name
    is_single = len(recording.streams) == 1
    streams = tuple(_replace_sensor(s, name) if is_single or not s.sensor else s for s in recording.streams)
    replaced = [s.sensor for s in recording.streams if is_single and s.sensor not in ("", name)]
    note = (f"the file names the sensor {replaced[0]}; {name} is used instead",) if replaced else ()
    return replace(recording, streams=streams, notes=recording.notes + note)


def with_reference(recording: Recording, reference: Image | Floats, origin: Path) -> Recording:
    """The recording with another reference for its only stream; raises SettingProblem for several streams."""
    if len(recording.streams) != 1:
        raise SettingProblem(
            f"a reference can be given for one stream, this recording has {len(recording.streams)}: '{origin}'"
        )

    def replace_reference(frame: TactileFrame) -> TactileFrame:
        if frame.image.shape != reference.shape:
            raise ShapeError(
                f"the reference has shape {reference.shape} and frame {frame.index} {frame.image.shape}: '{origin}'"
            )
        return replace(frame, reference=reference)

    return replace(recording, streams=(_map_frames(recording.streams[0], replace_reference),),
                   notes=(*recording.notes, f"{origin.name} is the reference"))  # fmt: skip


def _replace_sensor(stream: Stream, sensor: str) -> Stream:
    return replace(_map_frames(stream, lambda frame: replace(frame, sensor=sensor)), sensor=sensor)


def _map_frames(stream: Stream, change: Callable[[TactileFrame], TactileFrame]) -> Stream:
    read = stream.frame

    def frame(index: int) -> TactileFrame:
        return change(read(index))

    return replace(stream, frame=frame)
