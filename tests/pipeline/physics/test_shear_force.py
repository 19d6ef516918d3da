"""Shear force from markers: exact motions of simulated drags, and whole images."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.physics.contact_force import press_gel_contact
from pipeline.physics.sensor_images import render_reference
from pipeline.physics.shear import TangentialLoad
from pipeline.physics.shear_force import MarkerMotion, estimate_shear_force
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.contact_force import estimate_gel_force

GELSLIM = load_sensor("gelslim")


def drag(right_mm, down_mm, *, tool="hexagon", depth_mm=0.5, friction=0.8, seed=None):
    mesh = shapes.make_shape(tool).mesh
    pose = rigid.translation(0.4, -0.3, -depth_mm - mesh.vertices_mm[:, 2].min())
    load = TangentialLoad(displacement_mm=(right_mm, down_mm), friction=friction)
    return simulate_press(mesh, pose, GELSLIM, seed=seed, load=load)


def read_motion(touch):
    """The exact motion of a grid of surface points by the drag alone."""
    row, col = (a.ravel() for a in np.mgrid[20:320:38, 20:427:38])
    places = (np.stack([col, row], axis=1) + 0.5) * GELSLIM.pixel_mm
    return MarkerMotion(places_mm=places, motion_mm=touch.shear_mm[row, col].astype(float))


@pytest.mark.parametrize(
    ("right_mm", "down_mm", "friction"), [(0.1, 0.0, 5.0), (-0.15, 0.2, 5.0), (0.3, 0.3, 0.4)]
)
def test_exact_motion_gives_the_force_of_the_drag(right_mm, down_mm, friction):
    touch = drag(right_mm, down_mm, friction=friction)
    pressed = press_gel_contact(GELSLIM, touch.indentation_mm, touch.contact)
    found = estimate_shear_force(GELSLIM.gel, pressed, read_motion(touch))
    true = touch.truth.force_n[:2]
    assert np.linalg.norm(found - true) < 0.05 * np.linalg.norm(true)


def test_a_tenth_of_the_markers_that_jumped_to_a_neighbour_change_little():
    touch = drag(0.15, -0.1)
    pressed = press_gel_contact(GELSLIM, touch.indentation_mm, touch.contact)
    motion = read_motion(touch)
    wrong = motion.motion_mm.copy()
    wrong[::10] += (1.6, 0.0)
    found = estimate_shear_force(
        GELSLIM.gel, pressed, MarkerMotion(places_mm=motion.places_mm, motion_mm=wrong)
    )
    true = touch.truth.force_n[:2]
    assert np.linalg.norm(found - true) < 0.1 * np.linalg.norm(true)


@pytest.mark.parametrize("tool", ["hexagon", "sphere"])
def test_an_image_gives_the_force_of_the_drag(tool):
    """Within 15 % with the true depth.

    A press without drag has a hundredth of its normal force at most.
    """
    reference = render_reference(GELSLIM)
    for right_mm, down_mm in ((0.2, -0.1), (0.0, 0.0)):
        touch = drag(right_mm, down_mm, tool=tool, seed=3)
        frame = TactileFrame(sensor="gelslim", image=touch.image, reference=reference)
        found = estimate_gel_force(GELSLIM, frame, touch.indentation_mm, touch.contact)
        true = touch.truth.force_n[:2]
        assert np.linalg.norm(found.shear_n - true) < max(
            0.15 * np.linalg.norm(true), 0.01 * touch.force_n
        )


def test_no_shear_where_markers_or_the_reference_are_missing_or_noise_and_zero_without_contact():
    touch = drag(0.2, 0.0)
    dotless = load_sensor("gelslim_dotless")
    reference = render_reference(GELSLIM)
    frame = TactileFrame(sensor="gelslim", image=touch.image, reference=reference)
    alone = TactileFrame(sensor="gelslim", image=touch.image, reference=None)
    grey = TactileFrame(
        sensor="gelslim", image=np.full_like(reference, 90), reference=np.full_like(reference, 90)
    )
    noise = np.random.default_rng(0).integers(60, 200, reference.shape, np.uint8)
    grains = TactileFrame(sensor="gelslim", image=noise, reference=noise)
    for sensor, given in ((GELSLIM, alone), (dotless, frame), (GELSLIM, grey), (GELSLIM, grains)):
        assert (
            estimate_gel_force(sensor, given, touch.indentation_mm, touch.contact).shear_n is None
        )
    nothing = np.zeros_like(touch.indentation_mm)
    assert estimate_gel_force(GELSLIM, frame, nothing, np.zeros_like(touch.contact)).shear_n == (
        0.0,
        0.0,
    )
