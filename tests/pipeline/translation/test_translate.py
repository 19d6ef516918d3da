from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.sensors.spec import load_sensor
from pipeline.translation.translate import Request, estimate_camera_shift_mm, open_translation
from pipeline.values.frames import TactileFrame

BUBBLE = load_sensor("soft_bubble")


def still(reference, camera=BUBBLE.camera):
    return TactileFrame(sensor="soft_bubble", image=reference, reference=reference, camera=camera)


@pytest.mark.parametrize("shift_mm", [1.5, -2.25])
def test_another_units_camera_is_told_by_the_middle_of_its_untouched_membrane(shift_mm):
    """Only the middle fifth counts: the rim is where units differ in shape, and where readings are lost."""
    reference = (BUBBLE.rest_depth_mm - shift_mm).astype(np.float32)
    rows, cols = reference.shape
    middle = np.zeros(reference.shape, bool)
    middle[rows * 2 // 5 : rows * 3 // 5 + 1, cols * 2 // 5 : cols * 3 // 5 + 1] = True
    reference[~middle] = np.nan
    assert estimate_camera_shift_mm(still(reference), BUBBLE) == pytest.approx(shift_mm, abs=1e-4)
    assert estimate_camera_shift_mm(
        still(np.where(middle, reference, 3.0).astype(np.float32)), BUBBLE
    ) == pytest.approx(shift_mm, abs=1e-4)


def test_where_nothing_tells_there_is_no_shift():
    reference = BUBBLE.rest_depth_mm.astype(np.float32)
    assert estimate_camera_shift_mm(still(np.full_like(reference, np.nan)), BUBBLE) == 0.0
    assert estimate_camera_shift_mm(still(reference, camera=None), BUBBLE) == 0.0
    assert estimate_camera_shift_mm(replace(still(reference), reference=None), BUBBLE) == 0.0


def test_what_the_target_recorded_is_read_in_the_light_of_its_own_touches():
    sample = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
    with closing(open_translation(Request(recording=sample, source="gelslim", target="soft_bubble"))) as it:
        own = it.with_target_as_source()
        assert own.source.name == "soft_bubble"
        assert own.load_context_images(own.stream.frame(0).reference) == ()
        again = own.with_target_as_source()
        assert again.stream.name == it.stream.name
        assert [picture.shape for picture in again.load_context_images(it.stream.frame(0).reference)] == [
            picture.shape for picture in it.load_context_images(it.stream.frame(0).reference)
        ]
        assert it.load_context_images(it.stream.frame(0).reference)
        assert it.load_context_images(own.stream.frame(0).reference) == ()  # another sensor instance
