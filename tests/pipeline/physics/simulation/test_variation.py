import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import SettingProblem
from pipeline.physics import optics
from pipeline.physics.simulation.variation import MAX_STRENGTH, vary_sensor
from pipeline.sensors.spec import list_sensor_names, load_sensor

GELS = ("gelslim", "digit", "gelsight_mini")


@pytest.mark.parametrize("name", list_sensor_names())
def test_the_same_seed_gives_the_same_instance_and_strength_zero_the_sensor_itself(name):
    spec = load_sensor(name)
    first, again, other = (vary_sensor(spec, s) for s in (5, 5, 6))
    assert (first.optics, first.gel, first.markers, first.bubble) == (
        again.optics,
        again.gel,
        again.markers,
        again.bubble,
    )
    assert (first.optics, first.bubble) != (other.optics, other.bubble)
    assert vary_sensor(spec, 5, 0.0) is spec


@given(st.integers(0, 2**63), st.floats(0.0, MAX_STRENGTH), st.sampled_from(list_sensor_names()))
@settings(max_examples=60)
def test_every_instance_is_within_the_limits_of_a_description(seed, strength, name):
    instance = vary_sensor(load_sensor(name), seed, strength)
    assert (instance.name, instance.camera) == (name, load_sensor(name).camera)
    if instance.optics is not None:
        o = instance.optics
        assert all(0 <= share <= 1 for share in (o.falloff, o.vignette, o.shadow))
        assert min(o.blur_px, o.noise_grey) > 0
        assert all(5 <= led.elevation_deg <= 80 and min(led.rgb) >= 0 for led in o.leds)
        assert all(g.width > 0 and g.height > 0 for g in o.glows)
    if instance.gel is not None:
        assert 0.4 < instance.gel.thickness_mm / load_sensor(name).gel.thickness_mm < 2.0
        assert 0.2 < instance.gel.youngs_kpa / load_sensor(name).gel.youngs_kpa < 5.0
    if instance.markers is not None:
        m = instance.markers
        assert max(abs(p) for p in m.phase_mm) <= 0.5 * m.pitch_mm
        assert m.radius_mm + m.doubling_mm / 2 + m.jitter_mm < 0.65 * m.pitch_mm


@pytest.mark.parametrize("name", GELS)
def test_instances_differ_moderately(name):
    spec = load_sensor(name)
    plain = optics.render_reference(spec).astype(float)
    away = [
        np.abs(optics.render_reference(vary_sensor(spec, s)).astype(float) - plain).mean()
        for s in range(6)
    ]
    assert min(away) > 1.0  # grey levels
    assert max(away) < 45.0


def test_a_stronger_variation_goes_farther():
    spec = load_sensor("digit")
    plain = optics.render_reference(spec).astype(float)
    weak, strong = (
        np.mean(
            [
                np.abs(
                    optics.render_reference(vary_sensor(spec, s, k)).astype(float) - plain
                ).mean()
                for s in range(4)
            ]
        )
        for k in (0.2, 1.0)
    )
    assert strong > 2 * weak


def test_an_instance_at_rest_renders_as_its_reference():
    instance = vary_sensor(load_sensor("gelslim"), 3)
    level = np.zeros(instance.camera.shape, np.float32)
    assert np.array_equal(
        optics.render(instance, level, seed=None), optics.render_reference(instance)
    )


@pytest.mark.parametrize("strength", [-0.1, float("nan"), MAX_STRENGTH + 1])
def test_a_strength_out_of_range_is_refused(strength):
    with pytest.raises(SettingProblem, match="strength"):
        vary_sensor(load_sensor("digit"), 0, strength)
