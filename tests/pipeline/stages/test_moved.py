"""What counts as a change of a gel's picture."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from tests.pipeline.calibration.test_balls import hertz

# of a small film that was dithered and then enlarged
GRAIN_PX = 5
GRAIN_GREY = 9.0


def grainy(picture, seed):
    import cv2

    rows, cols = picture.shape[:2]
    small = np.random.default_rng(seed).normal(
        0, GRAIN_GREY, (rows // GRAIN_PX, cols // GRAIN_PX, 3)
    )
    grain = cv2.resize(small.astype(np.float32), (cols, rows), interpolation=cv2.INTER_CUBIC)
    return np.clip(np.rint(picture.astype(np.float32) + grain), 0, 255).astype(np.uint8)


def read(source, picture, seed):
    frame = TactileFrame(
        sensor=source.name,
        image=grainy(picture, seed),
        reference=grainy(optics.render_reference(source), 99),
    )
    return estimate_depth(frame, source, None, DepthParams())


@pytest.mark.parametrize("seed", range(4))
def test_grain_is_no_touch(seed):
    source = load_sensor("gelslim")
    assert not read(source, optics.render_reference(source), seed).contact.any()


def test_a_touch_is_found_through_grain():
    source = load_sensor("gelslim")
    pressed = hertz(source.camera.shape, source.pixel_mm, 200, 150, 7.6, 0.4)
    contact = read(source, optics.render(source, pressed, seed=None), 1).contact
    y, x = np.nonzero(contact)
    assert abs(x.mean() - 200) < 10
    assert abs(y.mean() - 150) < 10
