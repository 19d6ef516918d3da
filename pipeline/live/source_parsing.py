"""A source by the words that people give it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.live.folder_source import FolderSource
from pipeline.live.simulated_source import SimulatedSource
from pipeline.live.source import LiveSource
from pipeline.live.usb_camera import UsbCameraSource
from pipeline.sensors.spec import load_sensor as sensor_named

DEFAULT_SENSOR = "gelslim"  # that is simulated where nobody says


def parse_source(words: Sequence[str], *, sensor: str = "", tool: str = "sphere", rate_hz: float = 15.0) -> LiveSource:
    """`simulated`, `folder DIR` or `device NAME`, in quotes too; raises SettingProblem for anything else."""
    if sensor:
        sensor = sensor if sensor.endswith(".toml") else sensor_named(sensor).name
    match words[0].split(maxsplit=1) if len(words) == 1 else list(words):
        case ["simulated"]:
            return SimulatedSource(sensor=sensor or DEFAULT_SENSOR, tool=tool, rate_hz=rate_hz)
        case ["folder", name]:
            return FolderSource(Path(name), sensor=sensor)
        case ["device", name]:
            return UsbCameraSource(name, sensor=sensor)
        case _:
            raise SettingProblem(f"a source is simulated, folder DIR or device NAME, got {' '.join(words)!r}")
