from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.lab.evaluation.touch_metrics import BORDER_PX, compute_similarity_map


def similarity(a, b, data_range):
    """The mean, the border left out."""
    return compute_similarity_map(a, b, data_range)[
        BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX
    ].mean()


def textbook(a, b, data_range):
    """Wang et al. 2004, eq. 13, summed window by window, borders left out."""
    at = np.arange(-BORDER_PX, BORDER_PX + 1)
    row = np.exp(-(at**2) / (2 * 1.5**2))
    window = np.outer(row, row) / row.sum() ** 2
    c1 = (0.01 * data_range) ** 2
    c2 = (0.03 * data_range) ** 2
    found = []
    for r in range(BORDER_PX, a.shape[0] - BORDER_PX):
        for c in range(BORDER_PX, a.shape[1] - BORDER_PX):
            here = (
                slice(r - BORDER_PX, r + BORDER_PX + 1),
                slice(c - BORDER_PX, c + BORDER_PX + 1),
            )
            x = a[here]
            y = b[here]
            mx = (window * x).sum()
            my = (window * y).sum()
            vx = (window * (x - mx) ** 2).sum()
            vy = (window * (y - my) ** 2).sum()
            cov = (window * (x - mx) * (y - my)).sum()
            found.append(
                (2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
            )
    return float(np.mean(found))


@settings(max_examples=10)
@given(st.integers(0, 2**31), st.floats(0.1, 300.0))
def test_similarity_is_that_of_the_published_formula(seed, data_range):
    rng = np.random.default_rng(seed)
    a = rng.uniform(0, data_range, (17, 19))
    b = 0.5 * a + rng.uniform(0, 0.5 * data_range, (17, 19))
    assert similarity(a, b, data_range) == pytest.approx(textbook(a, b, data_range), abs=1e-10)


def test_similarity_is_that_of_scikit_image():
    skimage = pytest.importorskip("skimage.metrics", reason="scikit-image is not installed")
    rng = np.random.default_rng(1)
    a = rng.integers(0, 256, (60, 70, 3)).astype(np.uint8)
    b = np.clip(a + rng.normal(0, 20, a.shape), 0, 255).astype(np.uint8)
    theirs = skimage.structural_similarity(
        a,
        b,
        data_range=255,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    assert similarity(a, b, 255.0) == pytest.approx(theirs, abs=1e-10)


def test_equal_and_constant_pictures_have_a_similarity_too():
    flat = np.full((20, 20), 7.0)
    assert similarity(flat, flat, 255.0) == 1.0
    assert 0.0 < similarity(flat, flat + 100.0, 255.0) < 1.0


def test_a_change_in_one_place_lowers_the_similarity_there_alone():
    a = np.tile(np.linspace(0, 255, 60), (50, 1))
    b = a.copy()
    b[20:25, 40:45] += 60
    found = compute_similarity_map(a, b, 255.0)
    assert found[22, 42] < 0.9
    assert np.allclose(found[:, :30], 1.0)
