import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.views.drawing import CASING_COLOUR, CONTACT_COLOUR, list_outlines, make_scale_bar
from pipeline.views.preview import Preview

SQUARE = np.array([(2, 2), (9, 2), (9, 9), (2, 9), (2, 2)], np.float32)


def make_preview(rows=60, cols=80, pixel_mm=0.1, grey=200, **more):
    pixels = np.full((rows, cols, 3), grey, np.uint8)
    return Preview(pixels=pixels, frame_name="digit frame", pixel_mm=pixel_mm, **more)


@given(
    st.integers(20, 600),
    st.integers(20, 600),
    st.floats(0.005, 1.0),
    st.tuples(*[st.floats(0.0, 0.45)] * 4),
)
def test_the_bar_is_as_long_as_its_text_says_and_lies_in_what_is_visible(rows, cols, pixel_mm, cut):
    left = cut[0] * cols
    top = cut[1] * rows
    right = (1.0 - cut[2]) * cols
    bottom = (1.0 - cut[3]) * rows
    bar = make_scale_bar(make_preview(rows, cols, pixel_mm), (left, top, right, bottom))
    if bar is None:
        assert 0.3 * (right - left) * pixel_mm < 0.1
        return
    (start, y), (end, other_y) = bar.line.points_px
    number, unit = bar.text.split()
    assert unit == "mm"
    assert (end - start) * pixel_mm == pytest.approx(float(number))
    assert left < start < end < right
    assert top < y == other_y < bottom
    assert end - start <= 0.3 * (right - left)
    assert float(number) == 50.0 or (end - start) > 0.1 * (right - left)


@pytest.mark.parametrize("pixel_mm", [np.nan, np.inf, 0.0, -1.0])
def test_a_picture_without_a_scale_has_no_bar(pixel_mm):
    assert make_scale_bar(make_preview(pixel_mm=pixel_mm), (0, 0, 80, 60)) is None


def test_the_bar_is_light_on_dark_pixels_as_they_are_shown():
    dark, light = (
        make_scale_bar(make_preview(grey=grey), (0, 0, 80, 60)).line.rgb for grey in (20, 230)
    )
    assert min(dark) > 200 > 100 > max(light)
    assert (
        make_scale_bar(make_preview(grey=230), (0, 0, 80, 60), lambda pixels: 255 - pixels).line.rgb
        == dark
    )


def test_outlines_are_listed_from_the_lowest_to_the_one_on_top():
    lines = list_outlines(make_preview(outline_px=SQUARE, observed_outline_px=SQUARE + 1))
    assert [line.rgb for line in (lines[0], lines[-1])] == [CASING_COLOUR, CONTACT_COLOUR]
    assert lines[0].width > lines[1].width
    assert not list_outlines(make_preview(outline_px=np.zeros((0, 2), np.float32)))
