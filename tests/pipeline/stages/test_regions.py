"""Regions of masks, and the contact of a membrane."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.ndimage import binary_fill_holes

from pipeline.stages.depth.bubble_contact import detect_membrane_contact
from pipeline.stages.depth.regions import fill_holes


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.booleans()))
def test_what_a_mask_encloses_is_filled(mask):
    assert np.array_equal(fill_holes(mask), binary_fill_holes(mask))


def test_a_membranes_contact_has_no_holes():
    y, x = np.mgrid[:80, :80]
    r = np.hypot(x - 39.5, y - 39.5)
    surface = np.clip(25.0 - np.abs(r - 15.0) * 2.0, 0.0, 20.0).astype(np.float32)
    found = detect_membrane_contact(surface, least_mm=1.0, pressure_share=0.25, smoothing_px=2.0)
    assert found[39, 39]
    assert not found[0, 0]
