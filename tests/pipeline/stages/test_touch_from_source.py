"""Methods that generate a touch from the source frame alone, and their fallbacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.geometry import rigid
from pipeline.core.graph import Graph
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation.shapes import list_labelled_shapes, make_shape
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.network_factory import build_network
from pipeline.stages.networks.touch_formats import SIDE, normalise, resize_to_square
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.pose import network as pose_network
from pipeline.stages.touch import vqvae
from pipeline.stages.touch.frame_chain import make_touch_from_change
from pipeline.stages.touch.image_condition import reproject_square
from pipeline.stages.touch.physical_render import make_reference_touch
from pipeline.stages.touch_depth.stage import NO_MEMBRANE
from pipeline.translation.catalogue import BUILT_IN

GEL = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")
KINDS = {"source": "gel", "target": "bubble"}


def weights_of(kind, task, **config):
    torch.manual_seed(0)
    net = build_network(kind, config)
    if kind == "touch_pose":
        with torch.no_grad():
            net.pose.weight.zero_()
            net.pose.bias.copy_(torch.tensor([0.4, -0.2, *(1.0, 0.0) * net.n_folds]))
    tensors = {name: tensor.numpy() for name, tensor in net.state_dict().items()}
    return Weights(name="test", kind=kind, config=config, tensors=tensors, card={"task": task})


@pytest.fixture(scope="module")
def contact_frame():
    y, x = np.mgrid[: GEL.camera.rows, : GEL.camera.cols] * GEL.pixel_mm
    dent = np.maximum(0.6 - ((x - 9.0) ** 2 + (y - 7.0) ** 2) / 12.0, 0.0).astype(np.float32)
    image = optics.render(GEL, dent, seed=1)
    return TactileFrame(sensor="gelslim", image=image, reference=optics.render_reference(GEL))


def inputs(frame, **more):
    return {
        "frame": frame,
        "source": GEL,
        "target": BUBBLE,
        "calibration": None,
        "mesh": None,
        "previous": None,
        "previous_membrane": None,
        "alignment": alignment.resolve_alignment(GEL, BUBBLE),
        **more,
    }


def run(frame, weights, stage="touch"):
    graph = Graph(BUILT_IN.methods("t2d2", {"touch": "vqvae"}, KINDS))
    return graph.evaluate([stage], inputs(frame, touch_weights=weights), {})


def test_an_image_only_touch_has_its_depth_from_the_image(contact_frame):
    found = run(
        contact_frame,
        weights_of("vqvae", "vqvae", inputs=3, outputs=1, width=4, codes=8),
        "touch_depth",
    )
    # depth says that it is a touch
    assert list(found) == ["depth", "cloud", "target_depth", "touch", "touch_depth"]
    touch = found["touch"].output
    assert touch.image.shape == BUBBLE.camera.shape
    assert touch.membrane is None
    assert found["touch_depth"].fallback == NO_MEMBRANE


def test_missing_weights_fall_back_to_the_physical_chain(contact_frame):
    found = run(contact_frame, NoWeights(why="none are shipped"))["touch"]
    assert found.badge == "physics: no network for this pair"
    assert "none are shipped" in found.fallback
    assert found.output.membrane.contact.any()
    direct = (
        Graph(BUILT_IN.methods("t2d2", {"touch": "physics"}, KINDS))
        .evaluate(["touch"], inputs(contact_frame), {})["touch"]
        .output
    )
    assert np.array_equal(found.output.image, direct.image)


def test_source_warnings_are_passed_to_touches_without_depth(contact_frame):
    swapped = replace(
        contact_frame,
        image=contact_frame.image[:, :, ::-1],
        reference=contact_frame.reference[:, :, ::-1],
    )
    weights = weights_of("vqvae", "vqvae", inputs=3, outputs=1, width=4, codes=8)
    for frame, said in ((contact_frame, False), (swapped, True)):
        for given in (weights, NoWeights(why="none are shipped")):
            assert (
                any(
                    "red and blue look swapped" in warning
                    for warning in run(frame, given)["touch"].warnings
                )
                is said
            )
    assert any(
        "calibrated" in warning
        for warning in run(contact_frame, NoWeights(why="none are shipped"))["touch"].warnings
    )


def test_a_frame_without_contact_skips_the_network(contact_frame, monkeypatch):
    still = replace(contact_frame, image=contact_frame.reference)
    weights = weights_of("vqvae", "vqvae", inputs=3, outputs=1, width=4, codes=8)
    monkeypatch.setattr(vqvae, "_run_network", lambda *_: pytest.fail("the network was asked"))
    found = run(still, weights)["touch"]
    assert found.state == "skipped"
    assert np.array_equal(found.output.image, make_reference_touch(BUBBLE).image)


def test_weights_of_another_direction_are_refused(tmp_path):
    from pipeline.stages.networks.weights import save_weights

    file = tmp_path / "other.safetensors"
    save_weights(file, weights_of("vqvae", "vqvae", inputs=1, outputs=3, width=4, codes=8))
    found = vqvae.select_weights(GEL, BUBBLE, file)
    assert isinstance(found, NoWeights)
    assert "from a gel to a bubble" in found.why
    assert isinstance(vqvae.select_weights(BUBBLE, GEL, file), Weights)


def test_half_turn_rotates_the_output(contact_frame):
    plain, turned = (
        run(
            contact_frame,
            weights_of("vqvae", "vqvae", inputs=3, outputs=1, width=4, codes=8, half_turn=turn),
        )["touch"].output
        for turn in (False, True)
    )
    made = [BUBBLE.rest_depth_mm - touch.image for touch in (plain, turned)]
    assert np.allclose(made[0][::-1, ::-1], made[1], atol=0.05)


def test_the_source_square_is_resampled_to_the_target_view():
    """A spot of the gel's square lands where the bubble's camera sees that place of the gel's
    surface.
    """
    both = alignment.resolve_alignment(GEL, BUBBLE)
    eye, onto = (one.camera.resize(SIDE, SIDE) for one in (GEL, BUBBLE))
    rest = float(np.median(GEL.rest_depth_mm))
    for row, col in ((40, 30), (64, 64), (90, 100)):
        spot = np.zeros((3, SIDE, SIDE), np.float32)
        spot[:, row - 4 : row + 5, col - 4 : col + 5] = 0.5
        place = np.array(
            [(col - eye.cx_px) / eye.fx_px * rest, (row - eye.cy_px) / eye.fy_px * rest, rest]
        )
        x, y, seen = onto.project(rigid.apply(both.target_from_source, place[None]))
        assert seen.all()
        moved = reproject_square(spot, GEL, BUBBLE, both) - reproject_square(
            np.zeros_like(spot), GEL, BUBBLE, both
        )
        weight = moved[0] / moved[0].sum()
        rows, cols = np.mgrid[:SIDE, :SIDE]
        assert abs(float((weight * rows).sum()) - y[0]) < 0.6
        assert abs(float((weight * cols).sum()) - x[0]) < 0.6


def test_only_reprojecting_weights_get_a_resampled_square(contact_frame, monkeypatch):
    seen = []
    monkeypatch.setattr(
        vqvae, "_run_network", lambda _net, shown: seen.append(shown) or np.zeros((1, SIDE, SIDE))
    )
    for drawn in (False, True):
        run(
            contact_frame,
            weights_of(
                "vqvae", "vqvae", inputs=3, outputs=1, width=4, codes=8, reprojects_input=drawn
            ),
        )
    plain = resize_to_square(
        GEL.sensor_kind.compute_relative_change(contact_frame.image, contact_frame.reference)
    )
    assert np.array_equal(seen[0], normalise(plain, "gel"))
    assert np.array_equal(
        seen[1], reproject_square(plain, GEL, BUBBLE, alignment.resolve_alignment(GEL, BUBBLE))
    )


def test_a_change_is_added_to_the_reference_image():
    change = np.zeros((*GEL.camera.shape, 3), np.float32)
    change[10, 20] = (0.1, -0.1, 2.0)
    image = make_touch_from_change(GEL, change).image
    rest = optics.render_reference(GEL)
    changed = (image != rest).any(axis=2)
    assert np.argwhere(changed).tolist() == [[10, 20]]
    assert image[10, 20, 2] == 255
    assert abs(int(image[10, 20, 0]) - int(rest[10, 20, 0]) - 25.5) <= 1


def test_a_network_pose_stands_on_the_measured_surface(contact_frame):
    from pipeline.physics.simulation import shapes

    mesh = shapes.make_shape("star").mesh
    weights = weights_of("touch_pose", "touch_pose", inputs=1, n_objects=2, base_channels=4)
    graph = Graph(BUILT_IN.methods("t2d2", {"touch": "physics", "pose": "network"}, KINDS))
    found = graph.evaluate(["pose"], inputs(contact_frame, mesh=mesh, pose_weights=weights), {})
    pose = found["pose"].output
    touch_depth = found["touch_depth"].output
    placed = BUBBLE.alignment_from_sensor @ pose.sensor_from_object
    assert np.allclose(placed[:2, 3], (2.0, -1.0), atol=1e-5)
    lowest = rigid.apply(pose.sensor_from_object, mesh.vertices_mm)[:, 2].min()
    assert lowest == pytest.approx(float(touch_depth.depth_mm[touch_depth.contact].min()), abs=0.01)
    assert pose.notes == (pose_network.NOTE,)


@pytest.mark.parametrize(
    ("name", "rotation_deg"), [("star", 100.0 / 5), ("ellipse", 40.0 / 2), ("letters", 20.0)]
)
def test_a_network_pose_uses_the_symmetry_of_the_object(name, rotation_deg):
    """Cosine and sine of so many times the turn, and the network is said which object it is."""
    network = build_network(
        "touch_pose",
        {
            "inputs": 1,
            "n_objects": len(list_labelled_shapes()),
            "base_channels": 4,
            "n_folds": 6,
            "hidden_size": 8,
        },
    ).eval()
    angles = np.radians([20.0, 40.0, 60.0, 80.0, 100.0, 120.0])
    said = []
    network.fc2.register_forward_pre_hook(
        lambda _, given: said.append(given[0][0, -len(list_labelled_shapes()) :].numpy())
    )
    with torch.no_grad():
        network.pose.weight.zero_()
        network.pose.bias.copy_(
            torch.tensor([0.0, 0.0, *np.column_stack([np.cos(angles), np.sin(angles)]).ravel()])
        )
    x, y, turn = pose_network._predict_planar_pose(
        network, np.zeros((1, 128, 128), np.float32), make_shape(name).mesh
    )
    assert (x, y) == (0.0, 0.0)
    assert np.degrees(turn) == pytest.approx(rotation_deg, abs=1e-4)
    assert np.flatnonzero(said[0]).tolist() == [list_labelled_shapes().index(name)]
    pose_network._predict_planar_pose(
        network, np.zeros((1, 128, 128), np.float32), make_shape("hex_key").mesh
    )
    assert not said[1].any(), "an unknown object has no label"


def test_missing_pose_weights_fall_back_to_registration(contact_frame):
    graph = Graph(BUILT_IN.methods("t2d2", {"touch": "physics", "pose": "network"}, KINDS))
    given = inputs(contact_frame, mesh=None, pose_weights=NoWeights(why="none are shipped"))
    assert graph.evaluate(["pose"], given, {})["pose"].badge.startswith("mesh fit:")
