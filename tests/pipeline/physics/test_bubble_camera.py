from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.geometry.camera import Camera
from pipeline.physics import bubble, lattice
from pipeline.physics.lattice import Lattice
from pipeline.sensors.parts import DepthCamera
from pipeline.sensors.spec import load_sensor

SPEC = load_sensor("soft_bubble")
REST = SPEC.rest_depth_mm
NOISE_MM = SPEC.bubble.depth_noise_mm
QUIET = replace(SPEC, bubble=replace(SPEC.bubble, depth_noise_mm=0.0))
STEREO = load_sensor("soft_bubble_stereo")


def stepped(jump_mm):
    """The right half of the image lies farther away."""
    depth = np.full(SPEC.camera.shape, 70.0)
    depth[:, SPEC.camera.cols // 2 :] += jump_mm
    return depth


def test_rays_meet_a_sphere_where_the_equation_says():
    """Ray (a, b, 1) z and a sphere of radius r at distance d: (1 + a^2 + b^2) z^2 - 2 d z + d^2
    - r^2 = 0, nearer root.
    """
    camera = Camera(rows=41, cols=51, fx_px=60.0, fy_px=60.0, cx_px=25.0, cy_px=20.0)
    r = 40.0
    d = 100.0
    on = Lattice(x0_mm=-39.0, y0_mm=-39.0, step_mm=0.1, shape=(781, 781))
    low = np.maximum(r * r - on.x_mm()[None, :] ** 2 - on.y_mm()[:, None] ** 2, 0.0)
    seen = lattice.intersect_rays(
        camera, d - np.sqrt(low), on, guess_mm=np.full(camera.shape, d - r)
    )
    ray_x, ray_y = camera.rays()
    q = 1 + ray_x[None, :] ** 2 + ray_y[:, None] ** 2
    root = d * d - q * (d * d - r * r)
    exact = (d - np.sqrt(np.maximum(root, 0.0))) / q
    inner = root > 200.0  # away from the silhouette, where chords of 0.1 mm bend least
    assert inner.mean() > 0.5
    # sag of chords of 0.1 mm where the sphere bends away most
    assert np.abs(seen - exact)[inner].max() < 4e-4


def test_rays_meet_the_dome_where_the_equation_says():
    on = bubble.make_lattice(SPEC.bubble, 0.25)
    rest = bubble.compute_rest_z_mm(SPEC, on)
    seen = lattice.intersect_rays(SPEC.camera, rest, on, guess_mm=REST)
    points = SPEC.camera.back_project(seen)
    b = SPEC.bubble
    height = b.height_mm * (
        1 - (points[..., 0] / b.half_width_mm) ** 2 - (points[..., 1] / b.half_height_mm) ** 2
    )
    # chords of the lattice
    assert np.abs(points[..., 2] - bubble.get_rim_z_mm(SPEC) - height).max() < 1e-3


def test_without_a_seed_the_depth_is_exact():
    assert np.array_equal(bubble.simulate_depth_frame(SPEC, REST, None), REST.astype(np.float32))


def test_the_noise_of_the_bubble_at_rest_is_that_of_the_description():
    off = np.stack([bubble.simulate_depth_frame(SPEC, REST, seed) - REST for seed in range(4)])
    # 24 500 grains of about 8 pixels, four times
    assert np.sqrt((off**2).mean()) == pytest.approx(NOISE_MM, rel=0.03)
    assert abs(off.mean()) < 0.02


@pytest.mark.parametrize("grain_px", [0.0, 0.8, 2.5])
def test_a_coarser_grain_keeps_the_strength(grain_px):
    errs = replace(SPEC, depth_camera=DepthCamera(grain_px=grain_px))
    off = np.stack([bubble.simulate_depth_frame(errs, REST, seed) - REST for seed in range(6)])
    assert np.sqrt((off**2).mean()) == pytest.approx(NOISE_MM, rel=0.06)


def test_the_same_seed_gives_the_same_frame_and_another_differs():
    for spec in (SPEC, STEREO):
        one, same, other = (bubble.simulate_depth_frame(spec, REST, seed) for seed in (7, 7, 8))
        assert one.tobytes() == same.tobytes()
        assert one.tobytes() != other.tobytes()


def test_noise_grows_with_the_square_of_the_distance():
    level = np.ones(SPEC.camera.shape)
    near, far = (np.std(bubble.simulate_depth_frame(SPEC, z * level, 3) - z) for z in (40.0, 80.0))
    assert far / near == pytest.approx(4.0, rel=1e-3)


def test_noise_grows_on_a_surface_seen_at_a_grazing_angle():
    ray_x, _ = SPEC.camera.rays()
    # the plane z = 70 + 1.2 x
    tilted = 70.0 / (1 - 1.2 * ray_x)[None, :] * np.ones((SPEC.camera.rows, 1))
    middle = (slice(60, 70), slice(82, 92))
    cosine = bubble.compute_incidence_cosine(SPEC.camera, tilted)[middle]
    assert cosine == pytest.approx(1 / np.hypot(1, 1.2), abs=0.02)
    flat = np.full(SPEC.camera.shape, 70.0)
    errs = replace(SPEC, depth_camera=DepthCamera(distance_power=0.0, grazing_power=1.0))
    ratio = (bubble.simulate_depth_frame(errs, tilted, 5) - tilted)[middle] / (
        bubble.simulate_depth_frame(errs, flat, 5) - flat
    )[middle]
    assert np.median(ratio) == pytest.approx(np.hypot(1, 1.2), rel=0.03)


def test_pixels_fly_at_a_jump_and_nowhere_else():
    depth = stepped(12.0)
    seen = bubble.simulate_depth_frame(QUIET, depth, 1)
    moved = np.abs(seen - depth) > 1e-3
    middle = SPEC.camera.cols // 2
    assert not np.delete(moved, [middle - 1, middle], axis=1).any()
    assert 0.3 < moved[:, middle - 1 : middle + 1].mean() < 0.7
    assert seen.min() >= 70.0 - 1e-3
    assert seen.max() <= 82.0 + 1e-3


def test_nothing_flies_and_nothing_is_lost_on_the_bubble_itself():
    assert np.array_equal(bubble.simulate_depth_frame(QUIET, REST, 1), REST.astype(np.float32))
    coarse = SPEC.camera.scale(0.125)
    small = replace(QUIET, camera=coarse, rest_depth_mm=SPEC.membrane.rest_depth_mm(coarse))
    assert np.array_equal(
        bubble.simulate_depth_frame(small, small.rest_depth_mm, 1),
        small.rest_depth_mm.astype("f4"),
    )


def test_too_steep_a_surface_has_gaps():
    blinder = replace(QUIET, depth_camera=DepthCamera(max_incidence_deg=80.0))
    lost = np.isnan(bubble.simulate_depth_frame(blinder, stepped(12.0), 1))
    assert lost.any()
    assert not np.delete(lost, np.arange(85, 90), axis=1).any()


def test_stereo_depth_has_steps_and_gaps():
    seen = bubble.simulate_depth_frame(STEREO, REST, 2)
    known = seen[np.isfinite(seen)]
    assert np.abs(known * 10 - np.rint(known * 10)).max() < 1e-3
    assert 0.005 < np.isnan(seen).mean() < 0.05


def test_stereo_noise_is_shared_between_neighbours():
    def shared(spec):
        whole = replace(
            spec, depth_camera=replace(spec.depth_camera, gap_share=0.0, max_incidence_deg=90.0)
        )
        off = bubble.simulate_depth_frame(whole, REST, 4) - REST
        return np.corrcoef(off[:, :-1].ravel(), off[:, 1:].ravel())[0, 1]

    assert shared(STEREO) > 0.9 > shared(SPEC) > 0.5


def test_a_given_incidence_changes_no_frame():
    depth = REST - 3.0 * np.exp(-np.hypot(*np.mgrid[-70:70, -87:88]) / 20.0)
    known = bubble.compute_incidence_cosine(SPEC.camera, depth)
    assert np.array_equal(
        bubble.simulate_depth_frame(SPEC, depth, 5),
        bubble.simulate_depth_frame(SPEC, depth, 5, cosine=known),
    )
    assert np.array_equal(
        bubble.compute_rest_cosine(SPEC),
        bubble.compute_incidence_cosine(SPEC.camera, REST),
    )
    level = bubble.simulate_depth_frame(STEREO, depth, 5, cosine=np.ones_like(depth))
    assert not np.array_equal(level, bubble.simulate_depth_frame(STEREO, depth, 5), equal_nan=True)
