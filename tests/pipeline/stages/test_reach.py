"""A touch that is deeper than the source can have felt is doubted, wherever the sensors stand."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.doubts import doubts
from pipeline.physics import optics
from pipeline.sensors import alignment
from pipeline.sensors.spec import sensor
from pipeline.stages.generate import picture_to_touch
from pipeline.stages.generate.diffusion import DiffusionParams
from pipeline.stages.generate.pictured import touch_of
from pipeline.stages.generate.reach import deep
from pipeline.training.own_touches import nearer
from pipeline.values.frames import TactileFrame
from tests.pipeline.stages.test_learned_touch import Says

GEL, BUBBLE = sensor("gelslim"), sensor("soft_bubble")
DEEPEST_MM = 5.4  # of a GelSlim's 1.5 mm, beside which the bubble stands 3.9 mm nearer


def imprint(deep_mm):
    return touch_of(BUBBLE, np.full((*BUBBLE.camera.shape, 1), np.float32(deep_mm)))


@pytest.mark.parametrize(("deep_mm", "by_mm", "doubted"), [(4.6, 0.0, False), (13.0, 0.0, True), (13.0, 9.0, False)])
def test_only_what_is_deeper_than_the_sensors_stand_is_doubted(deep_mm, by_mm, doubted):
    bubble = nearer(BUBBLE, by_mm)
    told = deep(imprint(deep_mm), GEL, bubble, alignment.between(GEL, bubble))
    assert doubts(told) == told
    assert bool(told) is doubted
    if doubted:
        assert float(told[0].split()[0]) == pytest.approx(deep_mm - DEEPEST_MM, abs=0.6)


def test_a_body_beside_the_view_is_no_fault_and_a_gels_picture_tells_no_depth():
    touch, stand = imprint(0.0), alignment.between(GEL, BUBBLE)
    beside = np.array(touch.image)
    beside[:20] -= 13.0
    assert deep(replace(touch, image=beside), GEL, BUBBLE, stand) == ()
    assert deep(touch_of(GEL, np.ones((*GEL.camera.shape, 3), np.float32)), BUBBLE, GEL, stand) == ()


def test_sensors_that_see_nothing_of_each_other_are_left_to_others():
    far = replace(
        alignment.between(GEL, BUBBLE), target_from_alignment=np.diag([1.0, 1.0, 1.0, 1.0]) + 1e4 * np.eye(4, k=3)
    )
    assert deep(imprint(13.0), GEL, BUBBLE, far) == ()


def test_a_sample_of_touch_to_touch_says_so():
    still = optics.untouched(GEL)
    touched = still.copy()
    touched[120:200, 170:250] = 255 - touched[120:200, 170:250]
    frame, stand = TactileFrame(sensor="gelslim", image=touched, reference=still), alignment.between(GEL, BUBBLE)
    made = picture_to_touch.generate(frame, GEL, None, stand, BUBBLE, Says(13.0), DiffusionParams(steps=2))
    assert any("deeper than anything" in note for note in doubts(made.notes))
    fair = picture_to_touch.generate(frame, GEL, None, stand, BUBBLE, Says(2.0), DiffusionParams(steps=2))
    assert not any("deeper than anything" in note for note in fair.notes)
