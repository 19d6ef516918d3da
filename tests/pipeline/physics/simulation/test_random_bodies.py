import numpy as np
import pytest
from scipy import ndimage

from pipeline.core.geometry import rigid
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.physics.lattice import Lattice, rasterise_mesh
from pipeline.physics.simulation.random_bodies import STEP_MM, make_random_body
from pipeline.sensors.spec import load_sensor

BODIES = [make_random_body(np.random.default_rng([3, k])) for k in range(12)]


@pytest.mark.parametrize("mesh", BODIES)
def test_every_body_is_a_valid_height_field_with_its_lowest_point_at_zero(mesh):
    assert np.isfinite(mesh.vertices_mm).all()
    assert mesh.vertices_mm[:, 2].min() == 0.0
    assert mesh.triangles.min() == 0
    assert mesh.triangles.max() == len(mesh.vertices_mm) - 1
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert (normal[:, 2] < 0).all(), "every face looks to the sensor"


def test_the_same_state_gives_the_same_body_and_another_one_another():
    again = make_random_body(np.random.default_rng([3, 0]))
    assert np.array_equal(again.vertices_mm, BODIES[0].vertices_mm)
    areas = {len(mesh.triangles) for mesh in BODIES}
    assert len(areas) > 9


def test_some_bodies_have_level_faces_and_some_have_none():
    """Of what lies within 0.3 mm of the lowest point, nearly all is level, or nearly nothing."""
    on = Lattice(x0_mm=-24.0, y0_mm=-24.0, step_mm=STEP_MM, shape=(161, 161))
    shares = []
    for mesh in BODIES:
        z = rasterise_mesh(np.asarray(mesh.vertices_mm), mesh.triangles, on)
        shares.append((z < 1e-6).sum() / (z < 0.3).sum())
    assert max(shares) > 0.5
    assert min(shares) < 0.1


def test_outlines_enclose_what_is_free():
    on = Lattice(x0_mm=-24.0, y0_mm=-24.0, step_mm=STEP_MM, shape=(161, 161))
    n_rings = []
    for share in (0.0, 1.0):
        bodies = [
            make_random_body(
                np.random.default_rng([5, k]), unsupported_share=1.0, outline_share=share
            )
            for k in range(24)
        ]
        solid = [
            np.isfinite(rasterise_mesh(np.asarray(m.vertices_mm), m.triangles, on)) for m in bodies
        ]
        n_rings.append(sum(bool((ndimage.binary_fill_holes(a) & ~a).sum() > 100) for a in solid))
    assert n_rings[1] >= n_rings[0] + 3


def test_a_mesh_seen_through_a_camera_lies_where_its_rays_meet_it():
    """A tilted plane n . p = d is met at z = d / (n . (x, y, 1))."""
    camera = load_sensor("soft_bubble").camera
    tilt = rigid.rotation((0.1, -0.2, 0.0))
    tilt[2, 3] = 70.0
    square = np.array(
        [(-15.0, -15.0, 0.0), (15.0, -15.0, 0.0), (15.0, 15.0, 0.0), (-15.0, 15.0, 0.0)]
    )
    corners = rigid.apply(tilt, square)
    seen = render_mesh(corners, np.array([(0, 1, 2), (0, 2, 3)], np.int32), camera)[0]
    x, y = camera.rays()
    n = tilt[:3, 2]
    exact = n @ tilt[:3, 3] / (n[0] * x[None, :] + n[1] * y[:, None] + n[2])
    there = np.isfinite(seen)
    assert 0.15 < there.mean() < 0.5
    assert np.abs(seen - exact)[there].max() < 1e-9
