"""Force of a touch by the contact model, from exact surfaces of simulated presses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.contact_force import FORCE_MODELS

# contact in whole pixels, on coarser lattices: 0.5 % on gels, 4 % on bubbles (90th percentile)
EXACT_SHARE = 0.05


def press(name, depth_mm, tool="sphere", x_mm=0.0):
    mesh = shapes.make_shape(tool).mesh
    pose = rigid.translation(x_mm, 0.0, -depth_mm - mesh.vertices_mm[:, 2].min())
    return simulate_press(mesh, pose, load_sensor(name), seed=None)


def estimate(sensor, touch):
    frame = TactileFrame(sensor=sensor.name, image=touch.image, reference=None)
    estimator = FORCE_MODELS.get(sensor.sensor_kind)
    return estimator(sensor, frame, touch.indentation_mm, touch.contact).normal_n


@pytest.mark.parametrize(
    ("name", "depths_mm"), [("gelslim", (0.15, 0.5)), ("digit", (0.4,)), ("soft_bubble", (1, 6))]
)
def test_the_force_of_an_exact_surface_is_that_of_the_press(name, depths_mm):
    for depth_mm in depths_mm:
        touch = press(name, depth_mm)
        assert estimate(load_sensor(name), touch) == pytest.approx(touch.force_n, rel=EXACT_SHARE)


def test_force_on_a_bubble_does_not_depend_on_the_place_as_volume_does():
    ratios = []
    volumes = []
    for x_mm in (0.0, 25.0):
        touch = press("soft_bubble", 3.0, x_mm=x_mm)
        ratios.append(estimate(load_sensor("soft_bubble"), touch) / touch.force_n)
        volumes.append(float(touch.indentation_mm.sum()) / touch.force_n)
    assert ratios[1] / ratios[0] == pytest.approx(1.0, abs=EXACT_SHARE)
    assert abs(volumes[1] / volumes[0] - 1.0) > 2 * EXACT_SHARE


def test_force_is_proportional_to_stiffness_and_rises_with_depth():
    source = load_sensor("gelslim")
    touches = [press("gelslim", depth) for depth in (0.1, 0.2, 0.4, 0.8)]
    stiffer = replace(source, gel=replace(source.gel, youngs_kpa=2.0 * source.gel.youngs_kpa))
    forces = [estimate(source, touch) for touch in touches]
    assert np.all(np.diff(forces) > 0)
    assert estimate(stiffer, touches[1]) == pytest.approx(2.0 * forces[1], rel=1e-3)


def test_a_contact_cut_by_the_border_counts_what_probably_lies_beyond():
    source = load_sensor("gelslim")
    touch = press("gelslim", 0.4, "edge")
    assert touch.contact[:, -1].any()
    inside = replace(
        touch,
        truth=replace(
            touch.truth, contact=touch.contact & (np.indices(touch.contact.shape)[1] < 400)
        ),
    )
    assert estimate(source, touch) == pytest.approx(touch.force_n, rel=0.15)
    assert estimate(source, touch) > 1.05 * estimate(source, inside)
