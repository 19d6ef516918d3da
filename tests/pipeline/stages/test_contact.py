"""Which pressed regions of a gel are a contact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.ndimage import binary_fill_holes

from pipeline.stages.depth.contact import without_holes, without_margins

SHAPE = (60, 80)


@pytest.mark.parametrize(
    ("rows", "cols", "depth_mm", "kept"),
    [
        (slice(0, 9), slice(0, 12), 0.08, False),  # a corner of the gel that slid
        (slice(0, 9), slice(0, 12), 0.30, True),  # too deep for that
        (slice(0, 9), slice(0, 60), 0.08, True),  # longer than any corner
        (slice(0, 9), slice(20, 40), 0.08, True),  # at one side
        (slice(0, 60), slice(0, 12), 0.08, True),  # a face along three sides
        (slice(20, 30), slice(20, 30), 0.08, True),
    ],
)
def test_shallow_regions_in_a_corner_are_left_out(rows, cols, depth_mm, kept):
    mask, surface = np.zeros(SHAPE, np.bool_), np.zeros(SHAPE, np.float32)
    mask[rows, cols], surface[rows, cols] = True, depth_mm
    found = without_margins(mask, surface, slice(0, 60), slice(0, 80), SHAPE, 6.0)
    assert np.array_equal(found, mask if kept else np.zeros_like(mask))


def test_the_end_of_the_part_that_is_worked_on_is_no_side_of_the_picture():
    mask, surface = np.ones((10, 10), np.bool_), np.full((10, 10), 0.05, np.float32)
    assert without_margins(mask, surface, slice(5, 15), slice(5, 15), SHAPE, 6.0).all()
    assert not without_margins(mask, surface, slice(0, 10), slice(0, 10), SHAPE, 6.0).any()


@pytest.mark.parametrize(("wide", "kept"), [(5, False), (9, True)])
def test_a_strip_along_the_border_beside_a_larger_contact_is_left_out(wide, kept):
    mask = np.zeros(SHAPE, np.bool_)
    mask[25:45, 25:45] = True
    whole = mask.copy()
    whole[10:40, :wide] = True
    surface = whole.astype(np.float32)
    found = without_margins(whole, surface, slice(0, 60), slice(0, 80), SHAPE, 6.0)
    assert np.array_equal(found, whole if kept else mask)
    alone = whole & ~mask
    assert np.array_equal(without_margins(alone, surface, slice(0, 60), slice(0, 80), SHAPE, 6.0), alone)


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.booleans()))
def test_what_a_mask_encloses_is_filled(mask):
    assert np.array_equal(without_holes(mask), binary_fill_holes(mask))
