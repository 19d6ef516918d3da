"""A preview is drawn coarse and shown on as many pixels as the full picture, at the same place."""

from __future__ import annotations

import numpy as np

from pipeline.core.arrays import freeze
from pipeline.views.preview import Preview, add_observed_outline, enlarge_preview, trace_outline


def _coarse() -> Preview:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    return Preview(
        pixels=np.repeat(values[..., None], 3, axis=2).astype(np.uint8),
        values=values,
        frame_name="gelslim frame",
        positions_mm=np.zeros((3, 4, 3), np.float32),
        pixel_mm=0.4,
        outline_px=freeze(np.array([[1.0, 1.5], [3.0, 3.0]], np.float32)),
    )


def test_every_pixel_becomes_a_block_and_its_border_goes_along():
    large = enlarge_preview(_coarse(), (6, 8))
    assert np.array_equal(
        large.values, np.repeat(np.repeat(_coarse().values, 2, axis=0), 2, axis=1)
    )
    assert large.pixels.shape == (6, 8, 3)
    assert large.positions_mm.shape == (6, 8, 3)
    assert np.array_equal(large.outline_px, [[2.0, 3.0], [6.0, 6.0]])
    assert large.pixel_mm == 0.2


def test_a_picture_of_the_right_size_stays_what_it_is():
    picture = _coarse()
    assert enlarge_preview(picture, (3, 4)) is picture


def test_without_anything_felt_there_is_no_second_border():
    picture = _coarse()
    assert add_observed_outline(picture, None) is picture
    mask = np.zeros((3, 4), np.bool_)
    assert add_observed_outline(picture, trace_outline(mask)).observed_outline_px.shape == (0, 2)
