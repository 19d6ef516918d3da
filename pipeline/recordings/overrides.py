"""What the user says about a recording that its file does not, or says differently."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pipeline.base.arrays import Floats, Image
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.sensors.spec import load_sensor as sensor_spec
from pipeline.values.frames import Recording, Stream, TactileFrame


def with_sensor(recording: Recording, sensor: str) -> Recording:
    """The recording with `sensor` as the sensor of its only stream, or of the streams that do not name theirs."""
    if not sensor:
        return recording
    name = sensor_spec(sensor).name
    alone = len(recording.streams) == 1
    streams = tuple(_renamed(s, name) if alone or not s.sensor else s for s in recording.streams)
    changed = [s.sensor for s in recording.streams if alone and s.sensor not in ("", name)]
    note = (f"the file says {changed[0]}; taken as {name} as asked",) if changed else ()
    return replace(recording, streams=streams, notes=recording.notes + note)


def with_reference(recording: Recording, reference: Image | Floats, origin: Path) -> Recording:
    """The recording's only stream with another untouched reading; raises SettingProblem when it has several."""
    if len(recording.streams) != 1:
        raise SettingProblem(
            f"a reference can be given for a recording of one stream, this one has {len(recording.streams)}: '{origin}'"
        )

    def replace_reference(frame: TactileFrame) -> TactileFrame:
        if frame.image.shape != reference.shape:
            raise ShapeError(
                f"the reference has shape {reference.shape} and frame {frame.index} {frame.image.shape}: '{origin}'"
            )
        return replace(frame, reference=reference)

    return replace(recording, streams=(_mapped(recording.streams[0], replace_reference),),
                   notes=(*recording.notes, f"{origin.name} shows the untouched sensor, as asked"))  # fmt: skip


def _renamed(stream: Stream, sensor: str) -> Stream:
    return replace(_mapped(stream, lambda frame: replace(frame, sensor=sensor)), sensor=sensor)


def _mapped(stream: Stream, change: Callable[[TactileFrame], TactileFrame]) -> Stream:
    read = stream.frame

    def frame(index: int) -> TactileFrame:
        return change(read(index))

    return replace(stream, frame=frame)
