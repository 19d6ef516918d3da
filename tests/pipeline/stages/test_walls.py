"""Deep presses: walls that a camera hardly tells apart, and what stands on them."""

from __future__ import annotations

import numpy as np

from pipeline.geometry import rigid
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.stages.depth import poisson, wall_correction
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

PIXEL_MM = 0.1


def test_a_face_behind_steep_walls_is_as_deep_as_it_was_pressed():
    spec, thing = load_sensor("digit"), shapes.make_shape("cross").mesh
    pose = rigid.rotation((0.0, 0.0, 0.4))
    pose[2, 3] = -0.8 - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
    felt = simulate_press(thing, pose, spec, seed=0)
    frame = TactileFrame(sensor=spec.name, image=felt.image, reference=optics.render_reference(spec))
    told = estimate_depth(frame, spec, None, DepthParams())
    inside = felt.truth.contact
    off = 1e3 * np.abs(told.indentation_mm - felt.truth.indentation_mm)[inside].mean()
    assert off < 40.0  # 59 where a wall was no steeper than 55 degrees


def two_dents():
    y, x = np.mgrid[:40, :80].astype(np.float32)
    return sum(np.clip(1.5 - np.hypot(x - at, y - 20) / 8, 0.0, 1.0) for at in (20, 60)).astype(np.float32)


def test_dents_behind_walls_that_hardly_tell_are_raised_each_by_its_own():
    true = two_dents()
    gx, gy = compute_slopes(true, PIXEL_MM)
    low = true.copy()
    low[:, :40] *= np.float32(0.6)
    low[:, 40:] *= np.float32(0.8)
    steep = np.hypot(gx, gy) > 0.3
    sure = np.zeros((*true.shape, 3), np.float32)
    sure[..., 0] = sure[..., 2] = np.where(steep, 1.0, 100.0)
    found = wall_correction.raise_walls(low, (gx, gy), sure, PIXEL_MM)
    for part in (np.s_[:, :40], np.s_[:, 40:]):
        assert np.abs(found - true)[part].max() < 0.25 * np.abs(low - true)[part].max()


def test_a_level_surface_is_left_as_it_is():
    flat = np.zeros((20, 30), np.float32)
    assert wall_correction.raise_walls(flat, (flat, flat), np.ones((20, 30, 3), np.float32), PIXEL_MM) is flat


def test_surfaces_that_are_integrated_together_come_out_as_each_by_itself():
    rng = np.random.default_rng(0)
    wanted = rng.normal(size=(2, 3, 24, 31)).astype(np.float32)
    sure = np.zeros((24, 31, 3), np.float32)
    sure[..., 0], sure[..., 2] = rng.uniform(1.0, 9.0, (2, 24, 31))

    def integrated(gx, gy):
        return poisson.integrate_slopes(gx, gy, PIXEL_MM, "flat")

    still = np.zeros((3, 24, 31), np.float32)
    together = poisson.solve_weighted_slopes(still, (wanted[0], wanted[1]), sure, PIXEL_MM, integrated, 5)
    for k in range(3):
        alone = poisson.solve_weighted_slopes(still[k], (wanted[0, k], wanted[1, k]), sure, PIXEL_MM, integrated, 5)
        np.testing.assert_allclose(together[k], alone, atol=1e-5)
