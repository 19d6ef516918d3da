"""What the tests of the commands share: a small folder of touches, and a place of its own for
what goes wrong.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.physics.optics import render, render_reference
from pipeline.sensors.spec import load_sensor

MINI = load_sensor("gelsight_mini")


def save(path, image):
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def dent(depth_mm, seed=0):
    """A picture of a ball pressed this deep into a GelSight Mini."""
    y, x = np.mgrid[: MINI.camera.rows, : MINI.camera.cols] * MINI.pixel_mm
    r_sq = (x - 9.0) ** 2 + (y - 7.0) ** 2
    return render(MINI, np.maximum(depth_mm - r_sq / 8.0, 0.0).astype(np.float32), seed=seed)


@pytest.fixture
def touches(tmp_path):
    """A folder of three simulated GelSight Mini frames: untouched, and two dents."""
    folder = tmp_path / "touches"
    folder.mkdir()
    save(folder / "background.png", render_reference(MINI))
    for i, depth_mm in enumerate((0.0, 0.4, 0.6)):
        save(folder / f"touch_{i}.png", dent(depth_mm, seed=i))
    return folder


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    """The file that details of unexpected errors go to; not the user's own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "tactoscope" / "log" / "tactoscope.log"
