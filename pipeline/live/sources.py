"""A source by the words that people give it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.live.device import Device
from pipeline.live.folder import GrowingFolder
from pipeline.live.simulated import Simulated
from pipeline.live.source import Source
from pipeline.sensors.spec import sensor as sensor_named

USUAL_SENSOR = "gelslim"  # that is simulated where nobody says


def source_of(words: Sequence[str], *, sensor: str = "", tool: str = "sphere", rate_hz: float = 15.0) -> Source:
    """`simulated`, `folder DIR` or `device NAME`, in quotes too; raises SettingProblem for anything else."""
    if sensor:
        sensor = sensor if sensor.endswith(".toml") else sensor_named(sensor).name
    match words[0].split(maxsplit=1) if len(words) == 1 else list(words):
        case ["simulated"]:
            return Simulated(sensor=sensor or USUAL_SENSOR, tool=tool, rate_hz=rate_hz)
        case ["folder", name]:
            return GrowingFolder(Path(name), sensor=sensor)
        case ["device", name]:
            return Device(name, sensor=sensor)
        case _:
            raise SettingProblem(f"a source is simulated, folder DIR or device NAME, got {' '.join(words)!r}")
