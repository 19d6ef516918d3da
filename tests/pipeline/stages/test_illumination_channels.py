"""Input channels that show a gel network how bright a touch's light is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.physics import gel, optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import gel_network, gel_network_input, illumination_channels
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.values.frames import TactileFrame

DESCRIBED_LEDS = Illumination(model="leds", parameters=(0.0,) * 20)


def make_frame(source, depth_mm=0.4, brightness=1.0):
    rows, cols = source.camera.shape
    y, x = (source.pixel_mm * (np.arange(n) - n / 2) for n in (rows, cols))
    overlap = (depth_mm - np.hypot(x[None, :], y[:, None]) ** 2 / 8.0).astype(np.float32)
    pressed = gel.press_gel(source.gel, source.pixel_mm, overlap).indentation_mm
    leds = tuple(replace(led, rgb=tuple(brightness * v for v in led.rgb)) for led in source.optics.leds)
    instance = replace(source, optics=replace(source.optics, leds=leds))
    image, reference = optics.render(instance, pressed, seed=1), optics.render_reference(instance)
    return TactileFrame(sensor=source.name, image=image, reference=reference)


def read(source, **frame):
    _, measured, network_input = gel_network.estimate_physical_depth(make_frame(source, **frame), source)
    return measured, network_input


@pytest.mark.parametrize("name", ["gelslim", "gelslim_dotless", "digit", "gelsight_mini"])
def test_the_first_channels_are_those_of_any_light_and_one_names_the_sensor(name):
    source = load_sensor(name)
    measured, network_input = read(source)
    channels = illumination_channels.compute_all_channels(network_input, source, measured.illumination)
    assert channels.shape == (illumination_channels.N_ALL_CHANNELS, gel_network_input.ROWS, gel_network_input.COLS)
    first = channels[: gel_network_input.N_CHANNELS]
    assert np.array_equal(first, gel_network_input.compute_channels(network_input))
    assert np.isfinite(channels).all()
    named = [illumination_channels.TRAINED_SENSORS[k] for k in range(3) if channels[25 + k].all()]
    assert named == [name.removesuffix("_dotless")]
    assert not illumination_channels.explain_exclusion(source, measured.illumination)


def test_brighter_leds_appear_in_the_change_and_not_in_the_channels_of_any_light():
    source = load_sensor("gelsight_mini")
    plain, bright = (read(source, brightness=k)[1] for k in (1.0, 1.15))
    channels = [illumination_channels.compute_all_channels(one, source, DESCRIBED_LEDS) for one in (plain, bright)]
    touched = gel_network_input.compute_contact_mask(plain)
    grey = [np.abs(one[16:19][:, touched]).mean() for one in channels]
    assert grey[1] / grey[0] == pytest.approx(1.15, abs=0.03)
    assert np.abs(channels[1][:3] - channels[0][:3])[:, touched].mean() < 0.05


def test_fitted_leds_appear_in_standard_deviations_of_instances():
    source = load_sensor("gelsight_mini")
    network_input = read(source)[1]
    deviations = np.zeros((len(source.optics.leds), 5))
    deviations[:, 1], deviations[:, 2:] = 3.0, np.log(1.1)
    fitted = selection.pack_leds("leds", np.append(deviations.ravel(), np.zeros(5)))
    channels = illumination_channels.compute_all_channels(network_input, source, fitted)
    assert channels[20:23].mean() == pytest.approx(np.log(1.1) / 0.15, rel=1e-3)
    assert channels[23].mean() == pytest.approx(1.0, rel=1e-3)
    assert channels[24].all()
    for model, value in (("leds", 0.0), ("trusted", 0.0), ("near", -1.0), ("shadow_leds", -2.0)):
        channels = illumination_channels.compute_all_channels(network_input, source, Illumination(model=model))
        assert channels[24].mean() == value


@pytest.mark.parametrize("illumination", [Illumination(model="near"), Illumination(), None])
def test_touches_without_explaining_leds_are_excluded(illumination):
    assert "LEDs" in illumination_channels.explain_exclusion(load_sensor("digit"), illumination)


@pytest.mark.parametrize("name", illumination_channels.TRAINED_SENSORS)
def test_a_description_of_ones_own_is_matched_by_its_leds_and_not_by_its_name(name):
    source, trusted = load_sensor(name), Illumination(model="trusted")
    assert illumination_channels.match_trained_sensor(replace(source, name="mine")) == name
    for change in (
        lambda led: replace(led, azimuth_deg=(led.azimuth_deg + 60.0) % 360.0),
        lambda led: replace(led, elevation_deg=led.elevation_deg + 12.0),
        lambda led: replace(led, rgb=tuple(0.4 * v for v in led.rgb)),
    ):
        leds = tuple(change(led) for led in source.optics.leds)
        other = replace(source, name="mine", optics=replace(source.optics, leds=leds))
        assert illumination_channels.match_trained_sensor(other) == ""
        assert "mine" in illumination_channels.explain_exclusion(other, trusted)
    assert illumination_channels.match_trained_sensor(load_sensor("soft_bubble")) == ""
