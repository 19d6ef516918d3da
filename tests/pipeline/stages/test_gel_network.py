"""Depth of a gel by physics and a network: what becomes of what it tells."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.base.errors import ShapeError
from pipeline.base.progress import SILENT
from pipeline.calibration.calibration_table import BallFit, make_built_in
from pipeline.geometry import rigid
from pipeline.metrics.stage_metrics import iou, mean_abs_mm
from pipeline.networks import weights_registry
from pipeline.networks.gel_depth_opencv import GelDepthCorrection
from pipeline.networks.network_factory import load_predictor
from pipeline.networks.weights import NoWeights, Weights
from pipeline.physics import gel, optics
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import gel_network, gel_network_input, photometric
from pipeline.stages.depth.gel_network import NetworkParams, estimate_depth, estimate_physical_depth
from pipeline.stages.depth.stage import NETWORK
from pipeline.values.frames import TactileFrame


def disc(row, col, radius):
    y, x = np.mgrid[:120, :160].astype(np.float32)
    return (x - col) ** 2 + (y - row) ** 2 < radius**2


def told(correction_px, more, spread_px=0.1):
    """A network that tells this, whatever it sees."""

    def network(fields):
        inputs, rows, cols = fields.shape
        assert inputs == gel_network_input.N_CHANNELS
        first = (round(79.5 * float(fields[14, 0, 0] + 1)), round(59.5 * float(fields[15, 0, 0] + 1)))
        box = slice(first[1], first[1] + rows), slice(first[0], first[0] + cols)
        deep = np.float32(4 * np.exp(fields[gel_network_input.LOG_DEPTH_CHANNEL, 0, 0]))
        off, logit = (np.asarray(a, np.float32)[box] for a in (correction_px, more))
        return GelDepthCorrection(
            correction=off / deep,
            contact_logit_correction=logit,
            log_error_scale=0 * off + np.float32(np.log(spread_px / deep)),
        )

    network.calibrated = network.scaled = False
    return network


NOTHING = np.zeros((120, 160))


@pytest.fixture
def believed(monkeypatch):
    """Contact is believed wherever the network tells it."""
    monkeypatch.setattr(gel_network, "_PUSHED_IN", -1.0)


@cache
def frame(name="gelsight_mini", depth_mm=0.5):
    """A square punch in the middle."""
    source = load_sensor(name)
    rows, cols = source.camera.shape
    y, x = (source.pixel_mm * (np.arange(n) - n / 2) for n in (rows, cols))
    beside = np.maximum(np.abs(x)[None, :], np.abs(y)[:, None]) - 2.5
    pressed = gel.press_gel(source.gel, source.pixel_mm, (depth_mm - 8 * np.maximum(beside, 0.0)).astype(np.float32))
    image = optics.render(source, pressed.indentation_mm, seed=1)
    return TactileFrame(sensor=source.name, image=image, reference=optics.render_reference(source))


@cache
def physics(name="gelsight_mini"):
    return photometric.estimate_depth_with_notes(frame(name), load_sensor(name), None, photometric.DepthParams())


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim"])
def test_a_network_that_corrects_nothing_answers_physics_to_the_byte(name):
    found = estimate_depth(frame(name), load_sensor(name), None, told(NOTHING, NOTHING), NetworkParams())
    assert np.array_equal(found.indentation_mm, physics(name).indentation_mm)
    assert np.array_equal(found.contact, physics(name).contact)
    assert found.notes == physics(name).notes


def test_a_built_in_look_up_tells_how_wide_pixels_are():
    source = load_sensor("gelsight_mini")
    wide = replace(make_built_in(source), pixel_mm=1.25 * source.pixel_mm)
    found = estimate_depth(frame(), source, wide, told(NOTHING, NOTHING), NetworkParams())
    plain = photometric.estimate_depth_with_notes(frame(), source, wide, photometric.DepthParams())
    assert np.array_equal(found.indentation_mm, plain.indentation_mm)
    assert found.indentation_mm.max() > 1.15 * physics().indentation_mm.max()


@pytest.mark.usefixtures("believed")
@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim"])
def test_pixels_become_mm_on_the_sensors_own_picture(name):
    source, there = load_sensor(name), disc(52, 100, 20)
    network = told(np.where(there, 2.0, 0.0), np.where(there, 9.0, -9.0))
    found, before = estimate_depth(frame(name), source, None, network, NetworkParams()), physics(name)
    rows, cols = source.camera.shape
    pixel_mm = source.pixel_mm * max(rows, cols) / 160
    row, col = (100 / 160, 52 / 120) if rows > cols else (52 / 120, 100 / 160)
    middle = round(row * rows), round(col * cols)
    beside = rows // 2, cols // 2  # pressed in, and not corrected
    scale = found.indentation_mm[beside] / before.indentation_mm[beside]
    assert found.indentation_mm[middle] / scale - before.indentation_mm[middle] == pytest.approx(2 * pixel_mm, rel=0.02)
    assert found.contact[middle]
    assert not found.contact[rows // 20, cols // 20]
    assert found.contact.mean() == pytest.approx(there.mean(), rel=0.05)
    np.testing.assert_allclose(found.depth_mm, source.rest_depth_mm - found.indentation_mm, atol=1e-5)
    assert found.error.rms_mm == pytest.approx(0.1 * np.sqrt(2) * pixel_mm, rel=1e-4)
    assert found.expected_error_mm[middle] == pytest.approx(0.1 * pixel_mm, rel=1e-4)


def test_what_is_added_to_all_of_a_touch_alike_is_left_out():
    source = load_sensor("gelsight_mini")
    before = physics()
    at = gel_network_input.make_grid(source.camera.shape)
    deeper = at.resample_to_grid(before.indentation_mm) / (source.pixel_mm * at.pixels_per_cell)
    found = estimate_depth(frame(), source, None, told(deeper, NOTHING), NetworkParams())
    inside = before.contact
    off = np.abs(found.indentation_mm - before.indentation_mm)[inside].mean()
    assert off < 0.02 * before.indentation_mm[inside].mean()
    share = float(
        (found.indentation_mm * before.indentation_mm)[inside].sum() / (found.indentation_mm[inside] ** 2).sum()
    )
    assert share == pytest.approx(1.0, abs=1e-4)


def test_a_touch_that_is_none_to_the_network_leaves_no_depth_and_is_told():
    found = estimate_depth(frame(), load_sensor("gelsight_mini"), None, told(NOTHING, NOTHING - 9.0), NetworkParams())
    assert not found.contact.any()
    assert not found.indentation_mm.any()
    assert "nothing touches the sensor" in found.notes[-1]


def test_where_physics_finds_nothing_the_network_is_not_asked():
    source = load_sensor("gelsight_mini")
    still = optics.render_reference(source)
    network = told(NOTHING + 3.0, NOTHING + 9.0)
    untouched = TactileFrame(sensor=source.name, image=still, reference=still)
    found = estimate_depth(untouched, source, None, network, NetworkParams())
    assert not found.contact.any()
    assert not found.indentation_mm.any()


def test_a_calibrated_unit_is_left_to_its_look_up():
    source = load_sensor("gelsight_mini")
    press = BallFit(index=0, x_px=1.0, y_px=1.0, radius_px=1.0, residual=0.1, used=True)
    own = replace(make_built_in(source), presses=(press,))
    found = estimate_depth(frame(), source, own, told(NOTHING + 3.0, NOTHING), NetworkParams())
    by_look_up = photometric.estimate_depth_with_notes(frame(), source, own, photometric.DepthParams())
    assert np.array_equal(found.indentation_mm, by_look_up.indentation_mm)
    assert "the unit is calibrated" in found.notes[-1]


def test_a_speck_is_no_contact():
    network = told(NOTHING, np.where(disc(60, 80, 1.4), 9.0, -9.0))
    assert not estimate_depth(frame(), load_sensor("gelsight_mini"), None, network, NetworkParams()).contact.any()


def test_what_is_deeper_than_the_sensor_is_cut_and_told():
    source = load_sensor("gelsight_mini")
    spike = np.where(disc(60, 80, 2), 400.0, 0.0)
    found = estimate_depth(frame(depth_mm=1.2), source, None, told(spike, NOTHING), NetworkParams())
    assert found.indentation_mm.max() == np.float32(source.limits.indentation_max_mm)
    assert any("were cut to that" in note for note in found.notes)


@pytest.mark.usefixtures("believed")
def test_a_contact_at_the_border_is_told(monkeypatch):
    monkeypatch.setattr(gel_network_input, "_AROUND", 160)
    network = told(NOTHING, np.where(disc(0, 80, 30), 9.0, 0.0))
    found = estimate_depth(frame(), load_sensor("gelsight_mini"), None, network, NetworkParams())
    assert sum("reaches the image border" in note for note in found.notes) == 1


def test_a_picture_of_another_size_is_refused_as_physics_does():
    source = load_sensor("gelsight_mini")
    with pytest.raises(ShapeError, match="choose the right sensor"):
        estimate_depth(frame("digit"), source, None, told(NOTHING, NOTHING), NetworkParams())


def test_without_weights_physics_answers_and_says_so():
    source = load_sensor("gelsight_mini")
    answer = NETWORK.run(frame(), source, None, NoWeights(why="no weights come along"), NetworkParams(), SILENT)
    assert answer.why == "no weights come along; physics answers instead"


@pytest.mark.usefixtures("believed")
def test_what_the_network_adds_to_the_contact_is_as_deep_as_it_was_measured():
    source = load_sensor("gelsight_mini")
    network = told(NOTHING, np.where(disc(60, 80, 40), 9.0, 0.0))
    found, (before, measured, _) = (
        estimate_depth(frame(), source, None, network, NetworkParams()),
        estimate_physical_depth(frame(), source),
    )
    added = found.contact & ~before.contact
    here = (measured.window.rows, measured.window.cols)
    assert added[here].sum() > 300
    np.testing.assert_allclose(found.indentation_mm[here][added[here]], measured.surface_mm[added[here]], atol=1e-6)
    assert np.abs(before.indentation_mm - found.indentation_mm)[added].max() > 1e-3


def test_a_contact_is_not_believed_where_the_gel_is_hardly_pushed_in():
    """What the lamps throw beside a touch, a shadow say, looks like more of it."""
    found = estimate_depth(frame(), load_sensor("gelsight_mini"), None, told(NOTHING, NOTHING + 9.0), NetworkParams())
    before, measured, _ = estimate_physical_depth(frame(), load_sensor("gelsight_mini"))
    added = found.contact & ~before.contact
    assert added.any()
    assert measured.expand_to_frame()[added].min() > 0.2 * before.indentation_mm.max()
    assert found.contact.sum() < 2 * before.contact.sum()


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim"])
def test_the_weights_that_come_along_find_more_of_a_balls_contact_than_physics(name):
    source = load_sensor(name)
    rows, cols = source.camera.shape
    y, x = (source.pixel_mm * (np.arange(n) - n / 2) for n in (rows, cols))
    below = np.sqrt(np.maximum(3.0**2 - x[None, :] ** 2 - y[:, None] ** 2, 0.0)) - 3.0
    pressed = gel.press_gel(source.gel, source.pixel_mm, np.where(below > -3.0, 0.5 + below, -9.0).astype(np.float32))
    image = optics.render(source, pressed.indentation_mm, seed=1)
    touched = TactileFrame(sensor=source.name, image=image, reference=optics.render_reference(source))
    taught = weights_registry.load_shipped("gel_depth")
    assert isinstance(taught, Weights)
    by_network = estimate_depth(touched, source, None, load_predictor(taught), NetworkParams()).contact
    by_physics = photometric.estimate_depth_with_notes(touched, source, None, photometric.DepthParams()).contact
    assert iou(by_network, pressed.contact) > iou(by_physics, pressed.contact)
    assert not (by_network & ~by_physics & (pressed.indentation_mm < 0.05)).any()  # none of it where nothing is felt


def of_unit(name, index, depth_mm):
    """A tool that nothing has learned from, pressed into another unit: (frame, truth)."""
    source = load_sensor(name)
    unit, thing = vary_sensor(source, 900 + index), shapes.make_shape(shapes.list_shapes("unseen")[index]).mesh
    pose = rigid.rotation((0.0, 0.0, 0.7 * index))
    pose[2, 3] = -depth_mm - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
    felt = simulate_press(thing, pose, unit, seed=index)
    return TactileFrame(sensor=name, image=felt.image, reference=optics.render_reference(unit)), felt.truth


def test_the_network_that_comes_along_is_nearer_on_units_that_differ_as_a_labs_do():
    taught, off, told = load_predictor(weights_registry.load_shipped("gel_instances")), [], []
    for name in ("gelslim", "gelsight_mini", "digit"):
        for index in range(3):
            touched, truth = of_unit(name, index, 0.7)
            for found in (
                estimate_depth(touched, load_sensor(name), None, taught, NetworkParams()),
                photometric.estimate_depth_with_notes(touched, load_sensor(name), None, photometric.DepthParams()),
            ):
                off.append(mean_abs_mm(found.indentation_mm, truth.indentation_mm, truth.contact))
                told.append(found.error.rms_mm)
    by_network, by_physics = np.array(off).reshape(-1, 2).T
    assert 0.5 < np.median(np.array(told)[::2] / (1.25 * by_network)) < 2.0  # 1.25: of a Gaussian's rms over its mean
    assert by_network.mean() < 0.85 * by_physics.mean()


def test_the_scale_is_the_networks_where_that_is_more_and_between_both_where_it_is_less():
    field, touched = np.full((4, 4), 2.0, np.float32), np.ones((4, 4), np.bool_)
    assert gel_network._compute_depth_scale(field, 3 * field, touched, None) == pytest.approx(3.0)
    assert gel_network._compute_depth_scale(field, 4 * field, touched, float(np.log(9.0))) == pytest.approx(9.0)
    assert gel_network._compute_depth_scale(field, 9 * field, touched, float(np.log(4.0))) == pytest.approx(
        9 * (4 / 9) ** 0.6
    )
    surer = gel_network._compute_depth_scale(
        field, 9 * field, touched, float(np.log(4.0)), gel_network._WEIGHT_BELOW_WITH_CONTEXT
    )
    assert surer == pytest.approx(9 * (4 / 9) ** 0.3)  # other touches tell the lamps
    assert gel_network._compute_depth_scale(field, field, ~touched, 0.3) == 0.0


def test_in_another_light_the_scaled_network_is_not_asked(monkeypatch):
    monkeypatch.setattr(gel_network.light_fields, "why_not", lambda source, light: "physics' answer stands")
    taught = load_predictor(weights_registry.load_shipped("gel_instances"))
    found = estimate_depth(frame(), load_sensor("gelsight_mini"), None, taught, NetworkParams())
    assert np.array_equal(found.indentation_mm, physics().indentation_mm)
    assert any("physics' answer stands" in note for note in found.notes)
