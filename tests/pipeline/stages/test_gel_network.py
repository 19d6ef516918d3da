"""Depth of a gel by a network: what becomes of what it tells."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import ShapeError
from pipeline.networks.weights import NoWeights
from pipeline.physics import optics
from pipeline.sensors.spec import sensor
from pipeline.stages.depth.gel_network import NetworkParams, depth
from pipeline.stages.depth.slot import NETWORK
from pipeline.values.frames import TactileFrame


def disc(row, col, radius):
    y, x = np.mgrid[:120, :160].astype(np.float32)
    return (x - col) ** 2 + (y - row) ** 2 < radius**2


def told(surface_px, contact, spread_px=0.1):
    """A network that tells this, whatever it sees."""
    import torch
    from torch import nn

    from pipeline.networks.gel_reading import Reading

    class Told(nn.Module):
        def forward(self, fields):
            assert fields.shape == (1, 14, 120, 160)
            wide = [np.asarray(a, np.float32)[None] for a in (surface_px, np.where(contact, 4.0, -4.0))]
            surface, logit = (torch.from_numpy(a) for a in wide)
            nothing = torch.zeros_like(surface)
            return Reading(surface=surface, rough=nothing, slope_x=nothing, slope_y=nothing, contact=logit,
                           log_spread=nothing + float(np.log(spread_px)))  # fmt: skip

    return Told().eval()


def frame(source, **more):
    still = optics.untouched(source)
    return TactileFrame(sensor=source.name, image=still, reference=still, **more)


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim"])
def test_pixels_become_mm_on_the_sensors_own_picture(name):
    source, there = sensor(name), disc(40, 110, 25)
    found = depth(frame(source), source, None, told(np.where(there, 4.0, 0.0), there), NetworkParams())
    rows, cols = source.camera.shape
    pixel_mm = source.pixel_mm * max(rows, cols) / 160
    row, col = (110 / 160, 40 / 120) if rows > cols else (40 / 120, 110 / 160)
    middle = round(row * rows), round(col * cols)
    assert found.indentation_mm[middle] == pytest.approx(4.0 * pixel_mm, rel=0.01)
    assert found.contact[middle]
    assert found.contact.mean() == pytest.approx(there.mean(), rel=0.05)
    np.testing.assert_allclose(found.depth_mm, source.rest_depth_mm - found.indentation_mm, atol=1e-5)
    assert found.error.rms_mm == pytest.approx(0.1 * np.sqrt(2) * pixel_mm, rel=1e-4)


def test_no_contact_means_no_indentation_and_a_note():
    source = sensor("gelsight_mini")
    found = depth(frame(source), source, None, told(np.full((120, 160), 0.3), disc(0, 0, 0)), NetworkParams())
    assert not found.contact.any()
    assert not found.indentation_mm.any()
    assert found.error is None
    assert found.notes == ("nothing touches the sensor",)


def test_a_speck_is_no_contact():
    source = sensor("gelsight_mini")
    found = depth(frame(source), source, None, told(disc(60, 80, 1.4), disc(60, 80, 1.4)), NetworkParams())
    assert not found.contact.any()


def test_what_is_deeper_than_the_sensor_is_cut_and_told():
    source, there = sensor("gelsight_mini"), disc(60, 80, 30)
    found = depth(frame(source), source, None, told(np.where(there, 40.0, 0.0), there), NetworkParams())
    assert found.indentation_mm.max() == np.float32(source.limits.indentation_max_mm)
    assert any("were cut to that" in note for note in found.notes)


def test_a_contact_at_the_border_is_told():
    source, there = sensor("gelsight_mini"), disc(0, 80, 30)
    found = depth(frame(source), source, None, told(np.where(there, 4.0, 0.0), there), NetworkParams())
    assert any("reaches the image border" in note for note in found.notes)


def test_a_picture_of_another_size_is_refused_as_physics_does():
    source = sensor("gelsight_mini")
    other = frame(sensor("digit"))
    with pytest.raises(ShapeError, match="choose the right sensor"):
        depth(other, source, None, told(disc(0, 0, 0), disc(0, 0, 0)), NetworkParams())


def test_without_weights_physics_answers_and_says_so():
    source = sensor("gelsight_mini")
    answer = NETWORK.run(frame(source), source, None, NoWeights(why="no weights come along"), NetworkParams(), None)
    assert answer.why == "no weights come along; physics answers instead"
