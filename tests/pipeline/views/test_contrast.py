"""Colour limits of a presentation."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.contrast import FittedContrast
from pipeline.views.preview import Preview

SCALE = ColourScale(colour_map="diverging", low=-10.0, high=10.0, unit="mm", quantity="deviation")


def make_preview(depth_mm: float, scale: ColourScale = SCALE) -> Preview:
    values = np.linspace(0.0, depth_mm, 400, dtype=np.float32).reshape(20, 20)
    return Preview(
        pixels=apply_colour_map(values, scale), values=values, scale=scale, frame_name="a"
    )


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.0, 30.0), min_size=1, max_size=6))
def test_limits_hold_all_values_and_only_widen(depths_mm: list[float]):
    contrast = FittedContrast()
    before = 0.0
    for depth_mm in depths_mm:
        (fitted,) = contrast.fit(make_preview(depth_mm))
        assert fitted.scale is not None
        assert fitted.scale.low == -fitted.scale.high
        assert fitted.scale.is_fitted
        assert fitted.scale.high >= max(0.99 * depth_mm, before)
        before = fitted.scale.high
    assert before <= max(2.0 * max(depths_mm), 0.5), "not far wider than the deepest touch"


def test_images_of_one_quantity_share_their_limits_and_true_colours_stay():
    plain = Preview(pixels=np.zeros((4, 4, 3), np.uint8), frame_name="a")
    one, other, same = FittedContrast().fit(make_preview(1.0), make_preview(3.0), plain)
    assert one.scale == other.scale
    assert one.scale is not None
    assert one.scale.high == 3.0
    assert same is plain
