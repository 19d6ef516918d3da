import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.base.errors import SettingProblem
from pipeline.physics import optics
from pipeline.sensors.spec import list_sensor_names, load_sensor
from pipeline.simulation.variation import MAX_STRENGTH, vary_sensor

GELS = ("gelslim", "digit", "gelsight_mini")


@pytest.mark.parametrize("name", list_sensor_names())
def test_the_same_seed_gives_the_same_unit_and_strength_zero_the_sensor_itself(name):
    spec = load_sensor(name)
    first, again, other = (vary_sensor(spec, s) for s in (5, 5, 6))
    assert (first.optics, first.gel, first.markers, first.bubble) == (
        again.optics, again.gel, again.markers, again.bubble,
    )  # fmt: skip
    assert (first.optics, first.bubble) != (other.optics, other.bubble)
    assert vary_sensor(spec, 5, 0.0) is spec


@given(st.integers(0, 2**63), st.floats(0.0, MAX_STRENGTH), st.sampled_from(list_sensor_names()))
@settings(max_examples=60, deadline=None)
def test_every_unit_is_a_sensor_that_a_description_may_hold(seed, strength, name):
    unit = vary_sensor(load_sensor(name), seed, strength)
    assert (unit.name, unit.camera) == (name, load_sensor(name).camera)
    if unit.optics is not None:
        o = unit.optics
        assert all(0 <= share <= 1 for share in (o.falloff, o.vignette, o.shadow))
        assert min(o.blur_px, o.noise_grey) > 0
        assert all(5 <= led.elevation_deg <= 80 and min(led.rgb) >= 0 for led in o.leds)
        assert all(g.width > 0 and g.height > 0 for g in o.glows)
    if unit.gel is not None:
        assert 0.4 < unit.gel.thickness_mm / load_sensor(name).gel.thickness_mm < 2.0
        assert 0.2 < unit.gel.youngs_kpa / load_sensor(name).gel.youngs_kpa < 5.0
    if unit.markers is not None:
        m = unit.markers
        assert max(abs(p) for p in m.phase_mm) <= 0.5 * m.pitch_mm
        assert m.radius_mm + m.doubling_mm / 2 + m.jitter_mm < 0.65 * m.pitch_mm


@pytest.mark.parametrize("name", GELS)
def test_units_look_different_but_not_alien(name):
    spec = load_sensor(name)
    plain = optics.render_reference(spec).astype(float)
    away = [np.abs(optics.render_reference(vary_sensor(spec, s)).astype(float) - plain).mean() for s in range(6)]
    assert min(away) > 1.0  # grey levels
    assert max(away) < 45.0


def test_a_stronger_variation_goes_farther():
    spec = load_sensor("digit")
    plain = optics.render_reference(spec).astype(float)
    weak, strong = (
        np.mean(
            [np.abs(optics.render_reference(vary_sensor(spec, s, k)).astype(float) - plain).mean() for s in range(4)]
        )
        for k in (0.2, 1.0)
    )
    assert strong > 2 * weak


def test_a_unit_renders_level_ground_as_its_untouched_picture():
    unit = vary_sensor(load_sensor("gelslim"), 3)
    level = np.zeros(unit.camera.shape, np.float32)
    assert np.array_equal(optics.render(unit, level, seed=None), optics.render_reference(unit))


@pytest.mark.parametrize("strength", [-0.1, float("nan"), MAX_STRENGTH + 1])
def test_an_absurd_strength_is_refused(strength):
    with pytest.raises(SettingProblem, match="strength"):
        vary_sensor(load_sensor("digit"), 0, strength)
