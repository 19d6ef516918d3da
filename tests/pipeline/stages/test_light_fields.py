"""What a network is shown of how bright a touch's light is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.physics import gel, optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import gel_network, gel_network_input, illumination_channels
from pipeline.values.frames import TactileFrame


def frame(source, depth_mm=0.4, brighter=1.0):
    rows, cols = source.camera.shape
    y, x = (source.pixel_mm * (np.arange(n) - n / 2) for n in (rows, cols))
    overlap = (depth_mm - np.hypot(x[None, :], y[:, None]) ** 2 / 8.0).astype(np.float32)
    pressed = gel.press_gel(source.gel, source.pixel_mm, overlap).indentation_mm
    lamps = tuple(replace(led, rgb=tuple(brighter * v for v in led.rgb)) for led in source.optics.leds)
    unit = replace(source, optics=replace(source.optics, leds=lamps))
    return TactileFrame(
        sensor=source.name, image=optics.render(unit, pressed, seed=1), reference=optics.render_reference(unit)
    )


@pytest.mark.parametrize("name", ["gelslim", "gelslim_dotless", "digit", "gelsight_mini"])
def test_the_first_fields_are_those_of_any_light_and_one_tells_the_sensor(name):
    source = load_sensor(name)
    _, measured, seen = gel_network.estimate_physical_depth(frame(source), source)
    found = illumination_channels.compute_all_channels(seen, source, measured.light)
    assert found.shape == (illumination_channels.N_ALL_CHANNELS, gel_network_input.ROWS, gel_network_input.COLS)
    assert np.array_equal(found[: gel_network_input.N_CHANNELS], gel_network_input.compute_channels(seen))
    assert np.isfinite(found).all()
    which = [k for k in range(3) if found[25 + k].all()]
    assert [illumination_channels.TRAINED_SENSORS[k] for k in which] == [name.removesuffix("_dotless")]
    assert not illumination_channels.explain_exclusion(source, measured.light)


def test_brighter_lamps_show_in_the_change_and_not_in_the_fields_of_any_light():
    source = load_sensor("gelsight_mini")
    plain, bright = (gel_network.estimate_physical_depth(frame(source, brighter=k), source)[2] for k in (1.0, 1.15))
    shown = [illumination_channels.compute_all_channels(one, source, source.optics) for one in (plain, bright)]
    touched = gel_network_input.compute_contact_mask(plain)
    grey = [np.abs(fields[16:19][:, touched]).mean() for fields in shown]
    assert grey[1] / grey[0] == pytest.approx(1.15, abs=0.03)
    assert np.abs(shown[1][:3] - shown[0][:3])[:, touched].mean() < 0.05


def test_lamps_that_were_found_are_told_in_what_units_differ_by():
    source = load_sensor("gelsight_mini")
    _, _, seen = gel_network.estimate_physical_depth(frame(source), source)
    lamps = tuple(
        replace(led, rgb=tuple(1.1 * v for v in led.rgb), elevation_deg=led.elevation_deg + 3.0)
        for led in source.optics.leds
    )
    found = illumination_channels.compute_all_channels(seen, source, replace(source.optics, leds=lamps))
    assert found[20:23].mean() == pytest.approx(np.log(1.1) / 0.15, rel=1e-3)
    assert found[23].mean() == pytest.approx(1.0, rel=1e-3)
    assert found[24].all()
    for light, told in ((source.optics, 0.0), ("sure", 0.0), ("near", -1.0), (np.zeros(3), -2.0)):
        assert illumination_channels.compute_all_channels(seen, source, light)[24].mean() == told


@pytest.mark.parametrize("light", ["near", "even", None])
def test_light_that_no_lamps_explain_is_not_asked_of(light):
    assert "lamps explain" in illumination_channels.explain_exclusion(load_sensor("digit"), light)
    assert "learned from digit_mine" in illumination_channels.explain_exclusion(
        replace(load_sensor("digit"), name="digit_mine"), "sure"
    )
