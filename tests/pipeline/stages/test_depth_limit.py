"""Touches deeper than the source can be pressed have a warning, for any alignment."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.errors import select_warnings
from pipeline.core.graph import Fallback
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation.press import move_bubble_closer
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch import t2t
from pipeline.stages.touch.frame_chain import check_depth_limit, make_touch_from_change
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from tests.pipeline.stages.target_views import estimate_views
from tests.pipeline.stages.test_t2d2_t2t import ConstantDenoiser

GEL = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")
DEEPEST_MM = 5.4  # of a GelSlim's 1.5 mm, and the bubble camera is 3.9 mm nearer


def imprint(deep_mm):
    return make_touch_from_change(BUBBLE, np.full((*BUBBLE.camera.shape, 1), np.float32(deep_mm)))


@pytest.mark.parametrize(
    ("deep_mm", "by_mm", "has_warning"), [(4.6, 0.0, False), (13.0, 0.0, True), (13.0, 9.0, False)]
)
def test_only_touches_beyond_the_limit_have_a_warning(deep_mm, by_mm, has_warning):
    bubble = move_bubble_closer(BUBBLE, by_mm)
    warnings = check_depth_limit(
        imprint(deep_mm), GEL, bubble, alignment.resolve_alignment(GEL, bubble)
    )
    assert select_warnings(warnings) == warnings
    assert bool(warnings) is has_warning
    if has_warning:
        assert float(warnings[0].split("is ")[1].split()[0]) == pytest.approx(
            deep_mm - DEEPEST_MM, abs=0.6
        )


def test_objects_outside_the_view_and_gel_images_have_no_warning():
    touch = imprint(0.0)
    stand = alignment.resolve_alignment(GEL, BUBBLE)
    outside_view = np.array(touch.image)
    outside_view[:20] -= 13.0
    assert check_depth_limit(replace(touch, image=outside_view), GEL, BUBBLE, stand) == ()
    assert (
        check_depth_limit(
            make_touch_from_change(GEL, np.ones((*GEL.camera.shape, 3), np.float32)),
            BUBBLE,
            GEL,
            stand,
        )
        == ()
    )


def test_sensors_without_common_view_have_no_warning():
    far = replace(
        alignment.resolve_alignment(GEL, BUBBLE),
        target_from_alignment=np.diag([1.0, 1.0, 1.0, 1.0]) + 1e4 * np.eye(4, k=3),
    )
    assert check_depth_limit(imprint(13.0), GEL, BUBBLE, far) == ()


def test_physics_answers_for_t2t_that_is_deeper_than_the_source_can_be_pressed():
    still = optics.render_reference(GEL)
    touched = still.copy()
    touched[120:200, 170:250] = 255 - touched[120:200, 170:250]
    frame = TactileFrame(sensor="gelslim", image=touched, reference=still)
    stand = alignment.resolve_alignment(GEL, BUBBLE)
    view, found = estimate_views(frame, GEL, stand, BUBBLE)
    reads = frame, found, GEL, None, stand, BUBBLE, view
    deep = ConstantDenoiser(6.0)
    deep.unit_mm = 3.0  # 18 mm; the bubble is trained 13 mm inside the gel's surface
    made = t2t.generate_touch(*reads, deep, DiffusionParams(steps=8))
    assert isinstance(made, Fallback)
    assert len(deep.shown) == 1, "nothing is sampled"
    assert "deeper than the source" in made.reason
    fair = t2t.generate_touch(*reads, ConstantDenoiser(2.0), DiffusionParams(steps=2))
    assert not any("deeper than the source" in note for note in fair.notes)
