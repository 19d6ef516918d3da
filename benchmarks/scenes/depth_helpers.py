"""A depth method by its name, and recorded data that are not part of the project: for questions
about depth.

Not a question itself.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.geometry.camera import Camera
from pipeline.core.graph import Fallback, Skipped
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.stage import STAGE

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"

DepthReader = Callable[[TactileFrame, SensorSpec], DepthMap]


def build_reader(method: str = "") -> DepthReader:
    """Return the stage *depth* by this method, "" = the sensor's default.

    Uncalibrated: only the description is known.

    "network=FILE" gives weights in place of those that come along.
    """
    method, _, file = method.partition("=")
    if method and method not in {m.name for m in STAGE.methods}:
        raise SettingProblem(
            f"no depth method {method!r}; there are {', '.join(m.name for m in STAGE.methods)}"
        )

    def read(frame: TactileFrame, source: SensorSpec) -> DepthMap:
        found = next(
            m for m in STAGE.methods if m.name == method or (not method and m.fits(source.kind))
        )
        given: dict[str, object] = {"frame": frame, "source": source}
        if found.weights is not None:
            given[found.weights_name] = found.weights(source, source, Path(file) if file else None)
        answer = found.run(*(given.get(name) for name in found.reads), found.params(), SILENT)
        # another method's figures would stand under this one's name
        if isinstance(answer, Fallback):
            raise SettingProblem(answer.reason)
        return answer.output if isinstance(answer, Skipped) else answer

    return read


def recorded_data(given: str = "") -> Path:
    """The folder given, or that of TACTILE_DATA, or the one next to the project.

    Raises FileProblem without any.
    """
    folder = Path(given or os.environ.get("TACTILE_DATA", _BESIDE))
    if not folder.is_dir():
        raise FileProblem(
            "there are no recorded data here; set TACTILE_DATA to their folder", folder
        )
    return folder


def picture(path: Path):
    return np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])


def list_numbered_files(folder: Path, pattern: str) -> list[Path]:
    return sorted(
        folder.glob(pattern),
        key=lambda p: int("".join(c for c in p.stem.split("_")[-1] if c.isdigit())),
    )


def at_scale(source: SensorSpec, pixel_mm: float) -> SensorSpec:
    """The sensor with pixels of this width, as a unit has them."""
    c = source.camera
    focal = float(np.median(source.rest_depth_mm)) / pixel_mm
    camera = Camera(
        rows=c.rows, cols=c.cols, fx_px=focal, fy_px=focal, cx_px=c.cx_px, cy_px=c.cy_px
    )
    return dataclasses.replace(source, camera=camera)


def patches(contact) -> list[int]:
    """Pixels of every connected part of a contact, the largest first."""
    stats = cv2.connectedComponentsWithStats(contact.astype(np.uint8), connectivity=8)[2]
    return sorted((int(n) for n in stats[1:, cv2.CC_STAT_AREA]), reverse=True)
