"""Which pressed regions of a gel are a contact."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.stages.depth.contact import without_corners

SHAPE = (60, 80)


@pytest.mark.parametrize(
    ("rows", "cols", "depth_mm", "kept"),
    [
        (slice(0, 9), slice(0, 12), 0.08, False),  # a corner of the gel that slid
        (slice(0, 9), slice(0, 12), 0.30, True),  # too deep for that
        (slice(0, 9), slice(20, 40), 0.08, True),  # at one side
        (slice(0, 60), slice(0, 12), 0.08, True),  # a face along three sides
        (slice(20, 30), slice(20, 30), 0.08, True),
    ],
)
def test_shallow_regions_in_a_corner_are_left_out(rows, cols, depth_mm, kept):
    mask, surface = np.zeros(SHAPE, np.bool_), np.zeros(SHAPE, np.float32)
    mask[rows, cols], surface[rows, cols] = True, depth_mm
    found = without_corners(mask, surface, slice(0, 60), slice(0, 80), SHAPE)
    assert np.array_equal(found, mask if kept else np.zeros_like(mask))


def test_the_end_of_the_part_that_is_worked_on_is_no_side_of_the_picture():
    mask, surface = np.ones((10, 10), np.bool_), np.full((10, 10), 0.05, np.float32)
    assert without_corners(mask, surface, slice(5, 15), slice(5, 15), SHAPE).all()
    assert not without_corners(mask, surface, slice(0, 10), slice(0, 10), SHAPE).any()
