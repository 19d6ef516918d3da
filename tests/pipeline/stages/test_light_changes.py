"""Changes of the light that are no touch: spots, glints, dithering."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.metrics.stage_metrics import iou
from tests.pipeline.stages.test_depth import contact_of, press

PARAMS = DepthParams()
SENSORS = ("gelslim", "digit", "gelsight_mini")


def add_spot(image, *, grey, place, width, tint=(1.0, 1.0, 1.0)):
    """An image (rows, cols, 3) with a spot of light.

    Place and width as shares of its longer side.
    """
    rows, cols = image.shape[:2]
    y, x = np.mgrid[:rows, :cols] / max(rows, cols)
    spot = grey * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * width**2))
    noise = np.random.default_rng(0).normal(0, 1.5, image.shape)
    return np.clip(np.rint(image + spot[..., None] * np.array(tint) + noise), 0, 255).astype(
        np.uint8
    )


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("grey", [10.0, -10.0])
@pytest.mark.parametrize(("place", "width"), [((0.3, 0.3), 0.1), ((0.5, 0.4), 0.2)])
def test_a_spot_of_light_is_no_contact(name, grey, place, width):
    source = load_sensor(name)
    still = optics.render_reference(source)
    image = add_spot(still, grey=grey, place=place, width=width)
    found = estimate_depth(
        TactileFrame(sensor=name, image=image, reference=still), source, None, PARAMS
    )
    assert not found.contact.any()


@pytest.mark.parametrize("name", SENSORS)
def test_a_touch_next_to_a_spot_of_light_is_measured(name):
    source, frame, truth = press(name)
    spotted = replace(frame, image=add_spot(frame.image, grey=10.0, place=(0.1, 0.1), width=0.08))
    found = estimate_depth(spotted, source, None, PARAMS)
    assert iou(found.contact, contact_of(truth)) > 0.7


@pytest.mark.real_data
def test_a_glint_in_the_corner_of_a_real_mini_is_no_contact(real_data):
    folder = real_data / "mini_things" / "tennis_ball_3"
    mini = load_sensor("gelsight_mini")
    still, image = (
        cv2.imread(str(folder / file))[..., ::-1].copy() for file in ("ref.jpg", "frame_035.jpg")
    )
    found = estimate_depth(
        TactileFrame(sensor=mini.name, image=image, reference=still), mini, None, PARAMS
    )
    assert not found.contact.any()
    assert not found.indentation_mm.any()


@pytest.mark.real_data
def test_a_strong_glint_does_not_replace_a_real_touch(real_data):
    folder = real_data / "gsmini_balls"
    mini = load_sensor("gelsight_mini")
    still = cv2.imread(str(folder / "background.png"))[..., ::-1].copy()
    image = cv2.imread(str(sorted(folder.glob("ball_9.500mm_*.png"))[0]))[..., ::-1].copy()
    frame = TactileFrame(sensor=mini.name, image=image, reference=still)
    plain = estimate_depth(frame, mini, None, PARAMS)
    glint = image.copy()
    cv2.ellipse(glint, (8, 6), (9, 5), 30.0, 0.0, 360.0, (255, 255, 255), -1)
    found = estimate_depth(replace(frame, image=glint), mini, None, PARAMS)
    assert iou(found.contact, plain.contact) > 0.8
