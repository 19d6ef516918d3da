"""Live sources by name."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.live.folder_source import FolderSource
from pipeline.live.simulated_source import SimulatedSource
from pipeline.live.source import LiveSource
from pipeline.live.usb_camera import UsbCameraSource
from pipeline.sensors.spec import load_sensor

DEFAULT_SENSOR = "gelslim"  # of the simulated source


def parse_source(words: Sequence[str], *, sensor: str = "", tool: str = "sphere", rate_hz: float = 15.0) -> LiveSource:
    """The source for `simulated`, `folder DIR` or `device NAME`, as words or one text; raises SettingProblem."""
    if sensor:
        sensor = sensor if sensor.endswith(".toml") else load_sensor(sensor).name
    match words[0].split(maxsplit=1) if len(words) == 1 else list(words):
        case ["simulated"]:
            return SimulatedSource(sensor=sensor or DEFAULT_SENSOR, tool=tool, rate_hz=rate_hz)
        case ["folder", name]:
            return FolderSource(Path(name), sensor=sensor)
        case ["device", name]:
            return UsbCameraSource(name, sensor=sensor)
        case _:
            raise SettingProblem(f"a source is simulated, folder DIR or device NAME, got {' '.join(words)!r}")
