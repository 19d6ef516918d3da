"""A network's reading of a bubble; what it learned is measured by benchmarks/bubble_network.py."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import select_warnings
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.physics import bubble
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import bubble_network
from pipeline.stages.depth.bubble_network import NetworkParams
from pipeline.stages.depth.bubble_network_input import (
    N_CHANNELS,
    estimate_rest_surface,
    make_network_input,
)
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.metrics.stage_metrics import iou
from pipeline.stages.networks import network_factory

SPEC = load_sensor("soft_bubble")
REST = SPEC.rest_depth_mm.astype(np.float32)
BALL = 6.0 * np.exp(
    -0.5 * ((np.arange(140)[:, None] - 60) ** 2 + (np.arange(175)[None, :] - 90) ** 2) / 20.0**2
)


class Says:
    """A network that knows the answer: the move needs no correction, a disc is touched, a wider
    one is predicted.
    """

    def __init__(self, shape=(140, 175), gap_mm=0.3):
        row, col = (np.arange(n, dtype=np.float32) / n for n in shape)
        away = np.hypot(140 * (row[:, None] - 60 / 140), 175 * (col[None, :] - 90 / 175)).astype(
            np.float32
        )
        behind = np.log(np.expm1(np.maximum((away > 8) * gap_mm, 1e-4)))
        masks = [10.0 * (limit - away) for limit in (8.0, 14.0)]
        self.answer = np.stack([np.zeros(shape), behind, np.full(shape, -2.0), *masks]).astype(
            np.float32
        )
        self.pictures = []

    def __call__(self, picture):
        self.pictures.append(picture)
        assert picture.shape[-2:] == self.answer.shape[-2:]
        return (self.answer,)


def frame(rest=REST, moved=BALL):
    return TactileFrame(
        sensor="soft_bubble", image=(rest - moved).astype(np.float32), reference=rest
    )


def test_the_network_gets_the_channels_and_its_output_is_in_millimetres():
    network = Says()
    found = bubble_network.estimate_depth(frame(), SPEC, network, least_mm=0.7)
    assert network.pictures[0].shape == (N_CHANNELS, 140, 175)
    assert found.contact.sum() == pytest.approx(np.pi * 64, rel=0.05)
    assert np.abs(found.indentation_mm - BALL).max() < 0.05, "the smooth estimate of a smooth move"
    assert np.abs(found.depth_mm - (REST - BALL)).max() < 0.05
    assert np.nanmax(found.expected_error_mm) == pytest.approx(np.exp(-2.0))


def test_the_object_is_stated_in_contact_only():
    found = bubble_network.estimate_depth(frame(), SPEC, Says(), least_mm=0.7)
    assert np.array_equal(np.isfinite(found.object_depth_mm), found.contact)


def test_the_measured_depth_is_the_frame_without_its_gaps():
    given = frame()
    image = given.image.copy()
    image[20:40, 20:40] = 0.0
    found = bubble_network.estimate_depth(replace(given, image=image), SPEC, Says(), least_mm=0.7)
    assert np.isnan(found.measured_depth_mm[20:40, 20:40]).all()
    assert np.array_equal(found.measured_depth_mm[50:], image[50:])


def test_without_contact_no_object_is_predicted():
    found = bubble_network.estimate_depth(frame(moved=0.0 * BALL), SPEC, Says(), least_mm=0.7)
    assert not found.contact.any()
    assert np.isnan(found.object_depth_mm).all()
    assert "nothing touches the sensor" in found.notes


def test_a_finer_camera_is_resampled_to_the_working_pixels_and_back():
    fine = SPEC.with_camera(SPEC.camera.scale(2.0))
    rest = fine.rest_depth_mm.astype(np.float32)
    moved = np.kron(BALL, np.ones((2, 2)))
    found = bubble_network.estimate_depth(frame(rest, moved), fine, Says((140, 175)), least_mm=0.7)
    assert found.contact.shape == (280, 350)
    assert found.contact.sum() == pytest.approx(4 * np.pi * 64, rel=0.05)


def test_the_rest_surface_has_no_noise_of_the_reference():
    noisy = np.array(bubble.simulate_depth_frame(SPEC, SPEC.rest_depth_mm, 3))
    calm = estimate_rest_surface(noisy, np.ones(noisy.shape, bool), SPEC.pixel_mm)
    assert np.std(noisy - REST) > 0.3
    assert np.std(calm - REST) < 0.06
    bias = np.abs(estimate_rest_surface(REST, np.ones(noisy.shape, bool), SPEC.pixel_mm) - REST)
    assert bias.max() < 0.03
    assert bias[15:-15, 15:-15].max() < 0.005


def test_unmeasured_pixels_are_marked_and_large_gaps_have_no_value():
    image = (REST - BALL).astype(np.float32)
    image[20:60, 20:60] = np.nan
    network = Says()
    found = bubble_network.estimate_depth(
        replace(frame(), image=image), SPEC, network, least_mm=0.7
    )
    assert (network.pictures[0][4, 20:60, 20:60] == 0).all()
    assert (network.pictures[0][4, 70:, 70:] == 1).all()
    assert np.isnan(found.depth_mm[40, 40])
    assert np.isfinite(found.depth_mm[100, 100])


def test_noise_of_the_reference_is_in_two_channels_with_opposite_signs():
    """A network can only take it out if it is there twice."""
    noisy = np.array(bubble.simulate_depth_frame(SPEC, SPEC.rest_depth_mm, 3))
    seen = np.ones(noisy.shape, bool)
    looked_at = make_network_input(
        (noisy - REST).astype(np.float32), noisy, seen, SPEC.pixel_mm
    ).channels
    inner = (slice(10, -10), slice(10, -10))
    assert np.corrcoef(looked_at[0][inner].ravel(), looked_at[3][inner].ravel())[0, 1] > 0.9
    rough_mm = looked_at[3][inner] * 0.5
    assert np.std(rough_mm - (noisy - REST)[inner]) < 0.35 * np.std((noisy - REST)[inner])


def test_physics_removes_the_noise_of_the_reference_as_well():
    noisy = np.array(bubble.simulate_depth_frame(SPEC, SPEC.rest_depth_mm, 3))
    pressed = TactileFrame(
        sensor="soft_bubble", image=(REST - BALL).astype(np.float32), reference=noisy
    )
    found = estimate_depth(pressed, SPEC, None, DepthParams())
    assert found.contact.sum() > 50
    assert (
        np.std((found.depth_mm - (REST - BALL))[found.contact])
        < 0.2
        < np.std((noisy - REST)[found.contact])
    )
    as_read = estimate_depth(pressed, SPEC, None, DepthParams(smoothing_px=0.0))
    assert np.abs(as_read.depth_mm - pressed.image).max() < 1e-4, "asked for as it was read, it is"


@pytest.fixture(scope="module")
def shipped():
    weights = bubble_network.select_weights(SPEC, load_sensor("gelslim"), None)
    assert weights.card["task"] == "bubble_depth"
    return network_factory.load_predictor(weights)


def test_shipped_weights_are_nearer_than_physics_on_an_unseen_object(shipped):
    """A marble on another unit, both readings with their noise.

    Errors of the surface that the object has.
    """
    unit = vary_sensor(SPEC, 5)
    closer = replace(
        unit, alignment_from_sensor=rigid.translation(0, 0, 9.0) @ unit.alignment_from_sensor
    )
    thing = shapes.make_shape("marble").mesh
    truth = simulate_press(thing, rigid.translation(2.0, -1.0, -0.6), closer, seed=None).truth
    exact = SPEC.rest_depth_mm - truth.indentation_mm
    seen = frame(np.array(bubble.simulate_depth_frame(unit, SPEC.rest_depth_mm, 7)), 0.0)
    seen = replace(seen, image=bubble.simulate_depth_frame(unit, exact, 8))
    found = bubble_network.estimate_frame(seen, SPEC, None, shipped, NetworkParams())
    physics = estimate_depth(seen, SPEC, None, DepthParams())
    off, theirs = (np.abs(d.depth_mm - exact)[truth.contact].mean() for d in (found, physics))
    assert off < 0.15
    assert off < theirs
    assert iou(found.contact, truth.contact) > 0.7
    assert np.nanmean(np.abs(found.object_depth_mm - exact)[truth.contact]) < 0.15
    assert np.nanmean(found.expected_error_mm[truth.contact]) < 0.3


def test_shipped_weights_find_no_contact_in_drift_and_noise(shipped):
    rng = np.random.default_rng(4)
    noisy = np.array(bubble.simulate_depth_frame(SPEC, SPEC.rest_depth_mm, 1))
    for k in range(4):
        hump = rng.uniform(-0.6, 0.6) * np.exp(
            -((np.hypot(*np.mgrid[-70:70, -87:88]) / rng.uniform(20, 60)) ** 2)
        )
        image = np.array(
            bubble.simulate_depth_frame(SPEC, SPEC.rest_depth_mm, 10 + k)
        ) - hump.astype(np.float32)
        found = bubble_network.estimate_frame(
            replace(frame(noisy, 0.0), image=image), SPEC, None, shipped, NetworkParams()
        )
        assert not found.contact.any()


def estimate_real_contacts(shipped, frames):
    path = (
        Path(os.environ.get("TACTILE_DATA", "../shared/data"))
        / "punyo_bubble"
        / "depth_sequence.npz"
    )
    if not path.exists():
        pytest.skip(f"no {path}")
    stereo = load_sensor("soft_bubble_stereo")
    stream = open_recording(path, sensor=stereo.name).stream()
    return [
        bubble_network.estimate_frame(
            stream.frame(k), stereo, None, shipped, NetworkParams()
        ).contact
        for k in frames
    ]


@pytest.mark.real_data
def test_shipped_weights_tell_untouched_from_touched_frames_of_a_real_bubble(shipped):
    touched = estimate_real_contacts(shipped, (1, 2, 3, 4, 20))
    assert not np.any(touched[:4])
    assert touched[4].sum() > 100


@pytest.mark.real_data
def test_the_contact_of_a_steady_press_on_a_real_bubble_is_steady(shipped):
    areas = [contact.sum() for contact in estimate_real_contacts(shipped, (13, 14, 15, 16, 19, 20))]
    assert np.std(areas) < 0.05 * np.mean(areas)


def test_pixels_measured_far_from_the_membrane_do_not_change_its_roughness():
    seen = np.zeros(REST.shape, np.bool_)
    stray = np.array(REST)
    seen[20:120, 80:160] = True
    stray[100:108, 4:12] = 1.3 * REST[100:108, 4:12]
    with_stray = np.array(seen)
    with_stray[100:108, 4:12] = True
    alone, found = (
        make_network_input(
            0.0 * REST, np.where(mask, stray, 0.0).astype(np.float32), mask, SPEC.pixel_mm
        ).channels[3]
        for mask in (seen, with_stray)
    )
    assert np.abs(found - alone)[seen].max() < 0.01


@pytest.mark.parametrize(
    "read",
    [
        lambda frame: bubble_network.estimate_depth(frame, SPEC, Says(), least_mm=0.7),
        lambda frame: estimate_depth(frame, SPEC, None, DepthParams()),
    ],
)
def test_an_outward_bulge_gives_a_warning(read):
    warning = "farther out than the reference"
    assert not any(warning in note for note in read(frame()).notes)
    touched_before = frame(rest=REST - np.float32(BALL), moved=-np.float32(BALL))
    assert any(warning in note for note in select_warnings(read(touched_before).notes))
    flipped = frame(moved=-np.float32(BALL))
    assert any(warning in note for note in select_warnings(read(flipped).notes))
