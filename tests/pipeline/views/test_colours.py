"""The map of signed values around a dark centre: the same values, in colours that no other map
is touched by.
"""

from __future__ import annotations

import numpy as np

from pipeline.views.colours import NO_VALUE_COLOUR, darken_diverging, get_colour_table


def test_every_colour_of_the_diverging_map_becomes_that_of_the_dark_one():
    light = get_colour_table("diverging")
    dark = get_colour_table("diverging_dark")
    assert np.array_equal(darken_diverging(light), dark)
    assert np.array_equal(darken_diverging(light.reshape(16, 16, 3)), dark.reshape(16, 16, 3))


def test_other_colours_stay():
    rng = np.random.default_rng(0)
    colours = rng.integers(0, 256, (4000, 3), np.uint8)
    colours[0] = NO_VALUE_COLOUR
    known = {tuple(colour) for colour in get_colour_table("diverging").tolist()}
    others = np.array([c for c in colours.tolist() if tuple(c) not in known], np.uint8)
    assert np.array_equal(darken_diverging(others), others)


def test_the_dark_map_is_darkest_in_its_middle_and_as_bright_at_both_ends():
    grey = get_colour_table("diverging_dark").astype(float) @ (0.2126, 0.7152, 0.0722)
    assert 126 <= int(grey.argmin()) <= 129
    assert (np.diff(grey[:127]) <= 0.0).all()
    assert (np.diff(grey[129:]) >= 0.0).all()
    assert abs(grey[0] - grey[-1]) < 12.0
