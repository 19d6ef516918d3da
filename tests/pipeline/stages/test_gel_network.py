"""Depth of a gel by physics and a network."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pipeline.base.errors import AT_BORDER, ShapeError
from pipeline.base.progress import SILENT
from pipeline.calibration.calibration_table import BallFit, make_built_in
from pipeline.geometry import rigid
from pipeline.metrics.stage_metrics import compute_mae_mm
from pipeline.networks import weights_registry
from pipeline.networks.gel_depth_prediction import GelDepthPrediction
from pipeline.networks.network_factory import load_predictor
from pipeline.networks.weights import NoWeights
from pipeline.physics import gel, optics
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import gel_network, gel_network_input, illumination_channels, photometric
from pipeline.stages.depth.gel_network import NetworkParams, estimate_depth, estimate_physical_depth
from pipeline.stages.depth.stage import NETWORK
from pipeline.values.frames import TactileFrame


def disc(row, col, radius):
    y, x = np.mgrid[:120, :160].astype(np.float32)
    return (x - col) ** 2 + (y - row) ** 2 < radius**2


def make_network(correction_px, logit, error_px=0.1, log_depth_factor=None):
    """A network that predicts this whatever its input; without a depth factor, the one that leaves physics' scale."""

    def network(channels):
        assert channels.shape == (illumination_channels.N_ALL_CHANNELS, 120, 160)
        unit_px = np.float32(4 * np.exp(channels[gel_network_input.LOG_DEPTH_CHANNEL, 0, 0]))
        correction, logits = (np.asarray(a, np.float32) for a in (correction_px, logit))
        log_error = np.full((120, 160), np.log(error_px / unit_px), np.float32)
        factor = np.float32(0.0 if log_depth_factor is None else log_depth_factor)
        return GelDepthPrediction(
            surface=correction, correction=correction / unit_px, contact_logit=logits,
            contact_logit_correction=logits, log_error_scale=log_error, log_depth_factor=factor,
        )  # fmt: skip

    return network


NOTHING = np.zeros((120, 160))


@cache
def make_frame(name="gelsight_mini", depth_mm=0.5):
    """A square punch in the middle."""
    source = load_sensor(name)
    rows, cols = source.camera.shape
    y, x = (source.pixel_mm * (np.arange(n) - n / 2) for n in (rows, cols))
    outside = np.maximum(np.abs(x)[None, :], np.abs(y)[:, None]) - 2.5
    pressed = gel.press_gel(source.gel, source.pixel_mm, (depth_mm - 8 * np.maximum(outside, 0.0)).astype(np.float32))
    image = optics.render(source, pressed.indentation_mm, seed=1)
    return TactileFrame(sensor=source.name, image=image, reference=optics.render_reference(source))


@cache
def estimate_by_physics(name="gelsight_mini"):
    return photometric.estimate_depth_with_notes(make_frame(name), load_sensor(name), None, photometric.DepthParams())


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim"])
def test_a_network_that_corrects_nothing_gives_the_bytes_of_physics(name):
    depth = estimate_depth(make_frame(name), load_sensor(name), None, make_network(NOTHING, NOTHING), NetworkParams())
    physical = estimate_by_physics(name)
    assert np.array_equal(depth.indentation_mm, physical.indentation_mm)
    assert np.array_equal(depth.contact, physical.contact)
    assert depth.notes == physical.notes


def test_a_built_in_calibration_gives_the_pixel_width():
    source = load_sensor("gelsight_mini")
    wide = replace(make_built_in(source), pixel_mm=1.25 * source.pixel_mm)
    depth = estimate_depth(make_frame(), source, wide, make_network(NOTHING, NOTHING), NetworkParams())
    physical = photometric.estimate_depth_with_notes(make_frame(), source, wide, photometric.DepthParams())
    assert np.array_equal(depth.indentation_mm, physical.indentation_mm)
    assert depth.indentation_mm.max() > 1.15 * estimate_by_physics().indentation_mm.max()


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim"])
def test_the_prediction_is_resampled_to_the_sensors_pixels_in_mm(name):
    source, there = load_sensor(name), disc(52, 100, 20)
    network = make_network(np.where(there, 2.0, 0.0), np.where(there, 9.0, -9.0))
    depth = estimate_depth(make_frame(name), source, None, network, NetworkParams())
    before = estimate_by_physics(name)
    rows, cols = source.camera.shape
    pixel_mm = source.pixel_mm * max(rows, cols) / 160
    row, col = (100 / 160, 52 / 120) if rows > cols else (52 / 120, 100 / 160)
    corrected = round(row * rows), round(col * cols)
    uncorrected = rows // 2, cols // 2
    scale = depth.indentation_mm[uncorrected] / before.indentation_mm[uncorrected]
    added_mm = depth.indentation_mm[corrected] / scale - before.indentation_mm[corrected]
    assert added_mm == pytest.approx(2 * pixel_mm, rel=0.02)
    assert depth.contact[corrected]
    assert not depth.contact[rows // 20, cols // 20]
    assert depth.contact.mean() == pytest.approx(there.mean(), rel=0.05)
    np.testing.assert_allclose(depth.depth_mm, source.rest_depth_mm - depth.indentation_mm, atol=1e-5)
    rms_mm = gel_network._MEDIAN_ERROR_SHARE * 0.1 * np.sqrt(2) * pixel_mm
    assert depth.error.rms_mm == pytest.approx(rms_mm, rel=1e-4)
    assert depth.expected_error_mm[corrected] == pytest.approx(0.1 * pixel_mm, rel=1e-4)


def test_no_contact_by_the_network_leaves_no_depth():
    network = make_network(NOTHING, NOTHING - 9.0)
    depth = estimate_depth(make_frame(), load_sensor("gelsight_mini"), None, network, NetworkParams())
    assert not depth.contact.any()
    assert not depth.indentation_mm.any()
    assert depth.is_uncertain


def test_without_physical_contact_the_network_does_not_run():
    source = load_sensor("gelsight_mini")
    reference = optics.render_reference(source)
    untouched = TactileFrame(sensor=source.name, image=reference, reference=reference)
    depth = estimate_depth(untouched, source, None, make_network(NOTHING + 3.0, NOTHING + 9.0), NetworkParams())
    assert not depth.contact.any()
    assert not depth.indentation_mm.any()


def test_a_calibrated_sensor_is_left_to_its_calibration():
    source = load_sensor("gelsight_mini")
    press = BallFit(index=0, x_px=1.0, y_px=1.0, radius_px=1.0, residual=0.1, used=True)
    own = replace(make_built_in(source), presses=(press,))
    depth = estimate_depth(make_frame(), source, own, make_network(NOTHING + 3.0, NOTHING), NetworkParams())
    physical = photometric.estimate_depth_with_notes(make_frame(), source, own, photometric.DepthParams())
    assert np.array_equal(depth.indentation_mm, physical.indentation_mm)
    assert "calibrated" in depth.notes[-1]


def test_a_speck_is_no_contact():
    network = make_network(NOTHING, np.where(disc(60, 80, 1.4), 9.0, -9.0))
    depth = estimate_depth(make_frame(), load_sensor("gelsight_mini"), None, network, NetworkParams())
    assert not depth.contact.any()


def test_indentation_is_clipped_at_the_sensors_limit():
    source = load_sensor("gelsight_mini")
    network = make_network(np.where(disc(60, 80, 2), 400.0, 0.0), NOTHING)
    depth = estimate_depth(make_frame(depth_mm=1.2), source, None, network, NetworkParams())
    assert depth.indentation_mm.max() == np.float32(source.limits.indentation_max_mm)
    assert any(f"{source.limits.indentation_max_mm:g} mm" in note for note in depth.notes)


def test_a_contact_at_the_border_is_noted_once():
    network = make_network(NOTHING, np.where(disc(0, 80, 30), 9.0, 0.0))
    depth = estimate_depth(make_frame(), load_sensor("gelsight_mini"), None, network, NetworkParams())
    assert depth.notes.count(AT_BORDER) == 1


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ShapeError):
        estimate_depth(
            make_frame("digit"), load_sensor("gelsight_mini"), None, make_network(NOTHING, NOTHING), NetworkParams()
        )


def test_without_weights_physics_answers_with_the_reason():
    source = load_sensor("gelsight_mini")
    answer = NETWORK.run(make_frame(), source, None, NoWeights(why="no weights are shipped"), NetworkParams(), SILENT)
    assert "no weights are shipped" in answer.reason


def test_contact_that_the_network_adds_keeps_its_measured_depth():
    source = load_sensor("gelsight_mini")
    network = make_network(NOTHING, np.where(disc(60, 80, 40), 9.0, 0.0))
    depth = estimate_depth(make_frame(), source, None, network, NetworkParams())
    before, measured, _ = estimate_physical_depth(make_frame(), source)
    added = depth.contact & ~before.contact
    assert added.sum() > 300
    np.testing.assert_allclose(depth.indentation_mm[added], measured.gel.measured_mm[added], atol=1e-6)
    assert np.abs(before.indentation_mm - depth.indentation_mm)[added].max() > 1e-3


def simulate_touch(name, index, depth_mm):
    """An unseen tool pressed into another instance of a sensor: (frame, truth)."""
    source = load_sensor(name)
    instance, tool = vary_sensor(source, 900 + index), shapes.make_shape(shapes.list_shapes("unseen")[index]).mesh
    pose = rigid.rotation((0.0, 0.0, 0.7 * index))
    pose[2, 3] = -depth_mm - rigid.apply(pose, tool.vertices_mm)[:, 2].min()
    press = simulate_press(tool, pose, instance, seed=index)
    return TactileFrame(sensor=name, image=press.image, reference=optics.render_reference(instance)), press.truth


def test_shipped_weights_are_nearer_than_physics_on_instances_that_differ_as_a_labs_do():
    network = load_predictor(weights_registry.load_shipped("gel_instances"))
    errors, predicted = [], []
    for name in ("gelslim", "gelsight_mini", "digit"):
        for index in range(3):
            touched, truth = simulate_touch(name, index, 0.7)
            for depth in (
                estimate_depth(touched, load_sensor(name), None, network, NetworkParams()),
                photometric.estimate_depth_with_notes(touched, load_sensor(name), None, photometric.DepthParams()),
            ):
                errors.append(compute_mae_mm(depth.indentation_mm, truth.indentation_mm, truth.contact))
                predicted.append(depth.error.rms_mm)
    by_network, by_physics = np.array(errors).reshape(-1, 2).T
    gaussian_rms_over_mean = 1.25
    assert 0.5 < np.median(np.array(predicted)[::2] / (gaussian_rms_over_mean * by_network)) < 2.0
    assert by_network.mean() < 0.85 * by_physics.mean()


def test_the_depth_scale_follows_the_network_upward_and_in_part_downward():
    field, touched = np.full((4, 4), 2.0, np.float32), np.ones((4, 4), np.bool_)
    compute = gel_network._compute_depth_scale
    assert compute(field, 4 * field, touched, float(np.log(9.0))) == pytest.approx(9.0)
    assert compute(field, 9 * field, touched, float(np.log(4.0))) == pytest.approx(9 * (4 / 9) ** 0.6)
    with_context = compute(field, 9 * field, touched, float(np.log(4.0)), gel_network._WEIGHT_BELOW_WITH_CONTEXT)
    assert with_context == pytest.approx(9 * (4 / 9) ** 0.3)
    assert compute(field, field, ~touched, 0.3) == 0.0


def test_under_an_unexplained_light_the_network_does_not_run(monkeypatch):
    monkeypatch.setattr(gel_network.illumination_channels, "explain_exclusion", lambda source, light: "excluded")
    depth = estimate_depth(
        make_frame(), load_sensor("gelsight_mini"), None, make_network(NOTHING + 3.0, NOTHING), NetworkParams()
    )
    assert np.array_equal(depth.indentation_mm, estimate_by_physics().indentation_mm)
    assert depth.notes[-1] == "excluded"
