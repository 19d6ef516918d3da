"""Deep presses: walls that a camera hardly distinguishes, and what stands on them."""

from __future__ import annotations

import numpy as np

from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import poisson
from pipeline.stages.depth.gel.settings import SURFACE
from pipeline.stages.depth.illumination import surface_refinement
from pipeline.stages.depth.photometric import DepthParams, estimate_depth

PIXEL_MM = 0.1
MAX_ERROR_MM = 0.040  # mean in contact; 0.059 while walls were limited to 55 degrees


def test_a_face_behind_steep_walls_is_as_deep_as_it_was_pressed():
    source = load_sensor("digit")
    mesh = shapes.make_shape("cross").mesh
    pose = rigid.rotation((0.0, 0.0, 0.4))
    pose[2, 3] = -0.8 - rigid.apply(pose, mesh.vertices_mm)[:, 2].min()
    press = simulate_press(mesh, pose, source, seed=0)
    frame = TactileFrame(
        sensor=source.name, image=press.image, reference=optics.render_reference(source)
    )
    depth = estimate_depth(frame, source, None, DepthParams())
    error_mm = np.abs(depth.indentation_mm - press.truth.indentation_mm)[press.truth.contact].mean()
    assert error_mm < MAX_ERROR_MM


def test_a_level_surface_is_left_unchanged():
    flat = np.zeros((20, 30), np.float32)
    assert (
        surface_refinement.raise_walls(
            flat, (flat, flat), np.ones((3, 20, 30), np.float32), PIXEL_MM, SURFACE
        )
        is flat
    )


def test_several_surfaces_are_solved_as_each_alone():
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(2, 3, 24, 31)).astype(np.float32)
    weights = np.zeros((3, 24, 31), np.float32)
    weights[0], weights[2] = rng.uniform(1.0, 9.0, (2, 24, 31))
    flat_sides = poisson.SideBoundaries(*4 * ["flat"])
    integrate = poisson.Integrator(pixel_mm=PIXEL_MM, sides=flat_sides)
    flat = np.zeros((3, 24, 31), np.float32)
    together = poisson.solve_weighted_slopes(
        flat, (slopes[0], slopes[1]), weights, PIXEL_MM, integrate, 5
    )
    for k in range(3):
        alone = poisson.solve_weighted_slopes(
            flat[k], (slopes[0, k], slopes[1, k]), weights, PIXEL_MM, integrate, 5
        )
        np.testing.assert_allclose(together[k], alone, atol=1e-5)
