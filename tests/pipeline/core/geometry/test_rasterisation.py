"""The z-buffer against rays that are cast one by one (Moeller and Trumbore 1997)."""

import numpy as np
import pytest

from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import make_grid_triangles
from pipeline.core.geometry.rasterisation import rasterise_triangles, render_mesh

CAMERA = Camera(rows=23, cols=31, fx_px=28.0, fy_px=25.0, cx_px=14.3, cy_px=11.6)
ROUNDING_MM = 1e-9


def draw_soup(seed, n=40):
    """Triangles of all sizes and tilts, some cut by the image's border."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform((-20, -15, 20), (20, 15, 60), (n, 1, 3))
    corners = centres + rng.normal(0.0, rng.choice((0.2, 3.0, 12.0), (n, 1, 1)), (n, 3, 3))
    corners[..., 2] = np.maximum(corners[..., 2], 5.0)
    return corners.reshape(-1, 3), np.arange(3 * n, dtype=np.int32).reshape(n, 3)


def cast_rays(vertices, triangles):
    """Depth (rows, cols) by the intersection of each ray with each triangle, and how near each
    ray is to any edge.
    """
    x, y = CAMERA.rays()
    rays = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(CAMERA.shape)], axis=-1)[
        ..., None, :
    ]
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    across = np.cross(rays, c - a)
    det = (across * (b - a)).sum(axis=-1)
    u = (across * -a).sum(axis=-1) / det
    other = np.cross(-a, b - a)
    v = (rays * other).sum(axis=-1) / det
    t = ((c - a) * other).sum(axis=-1) / det
    inside = np.minimum.reduce([u, v, 1.0 - u - v])
    z = np.where((inside >= 0) & (t > 0), t, np.inf)
    return (
        z.min(axis=-1),
        np.where(np.isfinite(z).any(axis=-1), z.argmin(axis=-1), -1),
        np.abs(inside).min(axis=-1),
    )


@pytest.mark.parametrize("seed", range(8))
def test_every_pixel_sees_what_its_ray_meets_first(seed):
    vertices, triangles = draw_soup(seed)
    z, drawn = render_mesh(vertices, triangles, CAMERA)
    expected, which, to_edge = cast_rays(vertices, triangles)
    clear = to_edge > 1e-7
    assert clear.mean() > 0.99
    assert (np.isfinite(z) == np.isfinite(expected))[clear].all()
    np.testing.assert_array_equal(drawn[clear], which[clear])
    there = np.isfinite(z) & clear
    assert there.any()
    assert np.abs(z - expected)[there].max() < ROUNDING_MM * 60.0


def test_a_sheet_has_no_cracks_along_its_edges():
    """Nodes that lie exactly on common edges and corners are drawn."""
    rows = 9
    cols = 12
    y, x = np.mgrid[:rows, :cols].astype(float)
    nodes = np.stack([x.ravel(), y.ravel(), (3.0 * x - 2.0 * y).ravel()], axis=-1)
    height, drawn = rasterise_triangles(nodes, make_grid_triangles(rows, cols), (rows, cols))
    np.testing.assert_allclose(height, 3.0 * x - 2.0 * y, atol=ROUNDING_MM)
    assert (drawn >= 0).all()


@pytest.mark.parametrize("corner", [(np.nan, 0.0, 1.0), (2.0, np.inf, 1.0), (2.0, 2.0, np.nan)])
def test_a_corner_that_is_not_finite_removes_its_triangles_alone(corner):
    nodes = np.array([(0.0, 0.0, 1.0), (4.0, 0.0, 1.0), (0.0, 4.0, 1.0), corner])
    one, _ = rasterise_triangles(nodes, np.array([(0, 1, 2)], np.int32), (6, 6))
    both, drawn = rasterise_triangles(nodes, np.array([(0, 1, 2), (1, 2, 3)], np.int32), (6, 6))
    np.testing.assert_array_equal(both, one)
    assert drawn.max() == 0


@pytest.mark.parametrize("far", [1e6, 1e20, 3e38])
def test_a_corner_far_away_does_not_lower_what_lies_beyond_the_opposite_edge(far):
    nodes = np.array([(2.0, 0.0, 5.0), (2.0, 6.0, 5.0), (far, far, far)])
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1)):
        height, _ = rasterise_triangles(nodes, np.array([order], np.int32), (7, 7))
        assert (height[:, :2] == np.inf).all()
        assert height.min() >= 5.0 - ROUNDING_MM


def test_a_triangle_that_reaches_behind_the_lens_is_left_out():
    vertices = np.array([(-5.0, -5.0, 20.0), (5.0, -5.0, 20.0), (0.0, 5.0, 20.0), (0.0, 0.0, -1.0)])
    z, drawn = render_mesh(vertices, np.array([(0, 1, 2), (0, 1, 3)], np.int32), CAMERA)
    assert set(np.unique(drawn)) == {-1, 0}
    assert np.nanmax(z) == pytest.approx(20.0)
