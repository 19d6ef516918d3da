"""The Gauss-Newton step of the slopes where there is nearly nothing to move."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.stages.depth.illumination.illumination_kernels import N_LINES, TILE_PX, update_slopes


@pytest.mark.parametrize("cols", [3, TILE_PX, 200])
@pytest.mark.parametrize("confidence", [0.0, 1e-30, 1e-18])
def test_slopes_of_any_size_stay_finite_where_hardly_any_colour_counts(cols, confidence):
    shape = (40, cols)
    rendered, change, reference, weight = (
        np.full((*shape, 3), v, np.float32) for v in (0.0, 1.0, 90.0, confidence)
    )
    rate = np.random.default_rng(0).normal(size=(2, *shape, 3)).astype(np.float32)
    gx = np.repeat(np.logspace(-44, 0, shape[0]).astype(np.float32)[:, None], cols, axis=1)
    gy = np.zeros(shape, np.float32)
    before = gx.copy()
    limits = tuple(np.float32(v) for v in (500.0, 20.0, 1.43, 1e4))
    update_slopes(
        rendered,
        (change, reference),
        weight,
        np.ones(shape, bool),
        *rate,
        limits,
        np.empty(N_LINES * TILE_PX, np.float32),
        gx,
        gy,
        np.empty((3, *shape), np.float32),
    )
    assert gx == pytest.approx(before, rel=1e-5, abs=1e-12)
    assert gy == pytest.approx(np.zeros(shape), abs=1e-12)
