"""`tactoscope live`: watch a sensor without the window."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def live(
    *,
    source: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative="")] = ("simulated",),
    sensor: str = "",
    tool: Annotated[str, Parameter(name="--object")] = "sphere",
    rate: float = 15.0,
    record: Path | None = None,
    seconds: float = 0.0,
    list_devices: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Watch a sensor: say what really arrives, every second, and record it on the way.

    Parameters
    ----------
    source
        `simulated`, `folder DIR` into which another program writes pictures, or `device NAME`: a part of a camera's
        name or serial number, or the path of a camera or of a recorded stream.
    sensor
        The sensor, where neither a name nor the size of the pictures tells; which one is simulated.
    tool
        What is pressed into a simulated sensor: an object of `tactoscope simulate`, or a mesh.
    rate
        How many readings a second a simulated sensor gives.
    record
        File for a recording, an .h5 that can be opened while it grows and after a kill.
    seconds
        Stop after so long; 0 = at Ctrl-C.
    list_devices
        Only list the cameras that are plugged in.
    """
    from pipeline.cli.live import list_cameras, watch_sensor
    from pipeline.live.source_parsing import parse_source

    if list_devices:
        return list_cameras()
    return watch_sensor(parse_source(source, sensor=sensor, tool=tool, rate_hz=rate), record, seconds)
