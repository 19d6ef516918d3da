"""Press or drift: large, smooth touches and changes of the light, told apart by what explains
them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.calibration_table import make_built_in
from pipeline.core.errors import UNCERTAIN_CONTACT, UncertainContact
from pipeline.core.params import NoParams
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import make_depth_map
from pipeline.physics import gel, optics
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.cloud import back_projection
from pipeline.stages.depth import contact_force
from pipeline.stages.depth.gel import change, coarse_light
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, skip_without_contact
from pipeline.stages.target_depth import surface_projection
from pipeline.stages.touch import physical_render
from tests.pipeline.stages.test_drift import drifted

GELS = ("gelslim", "gelslim_dotless", "digit", "gelsight_mini")
DRIFT = {"gain": 1.03, "ramp_grey": 8.0, "shift_px": (1.4, -1.4)}


def press_soft_ball(name, *, radius_mm, depth_mm=0.3, unit_seed=0):
    """(described sensor, image of another instance, its reference, true surface) of a ball in
    the middle of the view.
    """
    source = load_sensor(name)
    unit = vary_sensor(source, unit_seed) if unit_seed else source
    rows, cols = source.camera.shape
    y, x = ((np.arange(n) - (n - 1) / 2) * source.pixel_mm for n in (rows, cols))
    pressed = gel.press_gel(
        unit.gel, source.pixel_mm, depth_mm - (x**2 + y[:, None] ** 2) / (2 * radius_mm)
    )
    return (
        source,
        optics.render(unit, pressed.indentation_mm, seed=1),
        optics.render_reference(unit),
        pressed,
    )


def explain_change(image, reference, source, light):
    """What explains the change of an image in this coarse light."""
    state = RestState(source=source, calibration=make_built_in(source), light=light, notes=())
    return change.observe_change(image, reference, state).press


@pytest.mark.parametrize("name", GELS)
@pytest.mark.parametrize(
    ("radius_mm", "unit_seed", "depth_mm"), [(120.0, 0, 0.3), (60.0, 4, 0.3), (60.0, 4, 0.13)]
)
def test_a_large_soft_ball_is_found_with_its_depth_and_contact(
    name, radius_mm, unit_seed, depth_mm
):
    source, image, reference, pressed = press_soft_ball(
        name, radius_mm=radius_mm, unit_seed=unit_seed, depth_mm=depth_mm
    )
    found = estimate_depth(
        TactileFrame(sensor=name, image=image, reference=reference), source, None, DepthParams()
    )
    assert found.indentation_mm.max() == pytest.approx(pressed.indentation_mm.max(), rel=0.25)
    assert found.contact.sum() == pytest.approx(pressed.contact.sum(), rel=0.3)


@pytest.mark.parametrize("name", GELS)
def test_drift_does_not_hide_a_large_soft_ball(name):
    source, image, reference, _ = press_soft_ball(name, radius_mm=120.0)
    frame = TactileFrame(sensor=name, image=drifted(image, **DRIFT), reference=reference)
    assert skip_without_contact(frame, source, None, DepthParams()) is None
    found = estimate_depth(frame, source, None, DepthParams())
    assert found.contact.any() or found.is_uncertain


@pytest.mark.parametrize("name", GELS)
def test_the_same_drift_alone_is_no_touch(name):
    source = load_sensor(name)
    still = optics.render_reference(source)
    found = explain_change(
        drifted(still, **DRIFT), still, source, coarse_light.describe_light(source)
    )
    assert found.verdict == "none"
    assert not found.dent_mm.any()


def test_touches_of_an_instance_tell_its_light():
    touches = [press_soft_ball("digit", radius_mm=r, unit_seed=7) for r in (20.0, 40.0)]
    source, image, reference, _ = press_soft_ball(
        "digit", radius_mm=30.0, depth_mm=0.2, unit_seed=7
    )
    described = coarse_light.describe_light(source)
    fitted = coarse_light.estimate_light(
        tuple(t[1] for t in touches), reference, source, source.pixel_mm
    )
    plain, own = (explain_change(image, reference, source, light) for light in (described, fitted))
    assert own.dent_evidence > plain.dent_evidence


def test_the_slopes_of_a_dent_are_those_of_its_heights():
    source = load_sensor("gelsight_mini")
    basis = coarse_light.make_dent_basis(source, source.pixel_mm)
    pressures = np.random.default_rng(0).uniform(0, 1, basis.heights.shape[-1]).astype(np.float32)
    heights = basis.heights @ pressures
    slopes = basis.slopes @ pressures
    down, right = np.gradient(heights, basis.block_mm)
    inside = (slice(1, -1), slice(1, -1))
    for analytic, finite in ((slopes[..., 0], right), (slopes[..., 1], down)):  # over a block
        assert np.corrcoef(analytic[inside].ravel(), finite[inside].ravel())[0, 1] > 0.98
    assert np.abs(slopes).mean() == pytest.approx(
        (np.abs(right).mean() + np.abs(down).mean()) / 2, rel=0.2
    )


@pytest.mark.parametrize(
    ("dent", "light", "verdict"),
    [
        (-200.0, 0.0, "none"),
        (50.0, 0.0, "uncertain"),
        (500.0, 600.0, "press"),
        (500.0, 2300.0, "uncertain"),
        (100.0, 3000.0, "none"),
    ],
)
def test_what_explains_a_change_better_decides(dent, light, verdict):
    assert change.decide(dent, light) == verdict


def test_an_uncertain_contact_is_nowhere_called_exact_and_has_no_force():
    source = load_sensor("gelslim")
    target = load_sensor("digit")
    shape = source.camera.shape
    depth = make_depth_map(
        source.rest_depth_mm,
        np.zeros(shape, np.float32),
        np.zeros(shape, np.bool_),
        source.camera,
        (UNCERTAIN_CONTACT,),
    )
    cloud = back_projection.skip_without_contact(
        depth, resolve_alignment(source, target), back_projection.BackProjectionParams()
    )
    view = surface_projection.skip_without_contact(
        cloud, target, surface_projection.SurfaceProjectionParams()
    )
    touch = physical_render.skip_without_contact(view, target)
    assert depth.is_uncertain
    for value in (cloud, view, touch):
        assert any(isinstance(note, UncertainContact) for note in value.notes)
        assert not any("exact" in note for note in value.notes)
    force = contact_force.skip_without_contact(depth, source, None, NoParams())
    assert math.isnan(force.normal_n)
    assert not replace(depth, notes=("nothing touches the sensor",)).is_uncertain
