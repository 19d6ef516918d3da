"""The order in which points come changes nothing: depths to the bit, and each pixel's point by
its name.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.pose.registration.observability import assess_observability
from pipeline.stages.target_depth.surface_projection import project_cloud
from tests.stability.rows import row
from tests.stability.scenes import (
    KINDS,
    aligned,
    cloud,
    depth_map,
    indentation_mm,
    projection,
    seeds,
    small,
)

SUMS = 1e-12  # relative: a sum of a few thousand numbers in another order


@row(3, "points in another order: the same bytes of depth, mask and indentation")
@given(
    st.sampled_from(KINDS), st.sampled_from(["surface", "paper"]), st.sampled_from([1, 2, 3]), seeds
)
def test_order_of_points(kind, mode, stride, seed):
    rng = np.random.default_rng(seed)
    source = small("gelslim")
    target = small("soft_bubble", 0.5)
    points = back_project_depth(
        depth_map(source, indentation_mm(source, kind, rng)),
        aligned(source, target),
        BackProjectionParams(stride=stride),
    )
    assert_same_in_any_order(points, target, mode, rng)


@row(3, "points at one place and in one pixel: the winner does not hang on the order")
@given(st.integers(1, 60), st.integers(1, 3), st.sampled_from(["surface", "paper"]), seeds)
def test_ties(n, places, mode, seed):
    rng = np.random.default_rng(seed)
    target = small("digit")
    spots = np.column_stack(
        [rng.uniform(-3, 3, (places, 2)), np.full(places, float(target.rest_depth_mm.min()) - 0.2)]
    )
    assert_same_in_any_order(cloud(spots[rng.integers(places, size=n)]), target, mode, rng)


def assert_same_in_any_order(points, target, mode, rng):
    order = rng.permutation(len(points.points_mm))
    shuffled = replace(
        points, points_mm=points.points_mm[order], source_index=points.source_index[order]
    )
    a, b = (project_cloud(p, target, projection(mode)) for p in (points, shuffled))
    for name in ("depth_mm", "contact", "indentation_mm", "in_view"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    assert a.notes == b.notes
    seen = a.source_index >= 0
    assert np.array_equal(
        points.source_index[a.source_index[seen]], shuffled.source_index[b.source_index[seen]]
    )


@row(3, "matched points in another order: the same observable motions but for the rounding of sums")
@given(st.integers(20, 400), seeds)
def test_observability_in_any_order(n, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-5, 5, (n, 3))
    normals = rng.standard_normal((n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = rng.permutation(n)
    a, b = (
        assess_observability(points[k], normals[k], points.mean(axis=0), 0.03)
        for k in (np.arange(n), order)
    )
    assert a.weak_directions == b.weak_directions
    assert np.abs(a.covariance - b.covariance).max() <= 1e3 * SUMS * np.abs(a.covariance).max()
    assert np.abs(a.observable - b.observable).max() <= 1e3 * SUMS
