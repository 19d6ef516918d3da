"""Touch by latent diffusion, from the source's image and from the target depth: seeds, guidance,
cancelling, conversion to mm, and two quirks of the released code.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pipeline.core.arrays import freeze
from pipeline.core.graph import Fallback, Graph
from pipeline.core.progress import Cancelled
from pipeline.core.values.results import TargetDepth
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.latent_diffusion import LatentDiffusion
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.samplers import NO_CONDITION_DROPOUT
from pipeline.stages.networks.touch_formats import BUBBLE as BUBBLE_FORMAT
from pipeline.stages.networks.touch_formats import decode_image, encode_image, normalise
from pipeline.stages.networks.weights import NoWeights, Weights, save_weights
from pipeline.stages.touch import latent_diffusion
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image
from pipeline.stages.touch.t2d2 import build_depth_square
from pipeline.translation.catalogue import BUILT_IN
from tests.pipeline.stages.target_views import estimate_views

SHOWN = np.random.default_rng(0).normal(size=(3, 32, 32)).astype(np.float32)


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    made = LatentDiffusion(
        side=32,
        width=8,
        channel_multipliers="1 2",
        blocks=1,
        attention="2",
        heads=2,
        groups=4,
        autoencoder_width=8,
        autoencoder_multipliers="1 1 2 2",
        autoencoder_blocks=1,
        condition_channels=4,
    )
    with torch.no_grad():
        made.model["diffusion_model"].out[2].weight.normal_(0, 0.02)
    return made.eval().requires_grad_(False)


def counted(net, monkeypatch):
    calls = []
    plain = type(net).predict_noise
    monkeypatch.setattr(
        type(net), "predict_noise", lambda self, *a: calls.extend(a[2]) or plain(self, *a)
    )
    return calls


@pytest.mark.parametrize(("guidance", "passes"), [(1.0, 1), (0.0, 1), (2.54, 2)])
def test_guidance_one_costs_one_pass_per_step(net, monkeypatch, guidance, passes):
    calls = counted(net, monkeypatch)
    sample_image(net, SHOWN, LatentParams(steps=40, guidance=guidance))
    assert len(calls) == passes * 40


def test_guidance_acts_only_on_weights_trained_with_condition_dropout(net, monkeypatch):
    def made(guidance):
        return sample_image(net, SHOWN, LatentParams(steps=8, guidance=guidance))

    assert not np.array_equal(made(1.0)[0], made(4.0)[0])
    monkeypatch.setattr(net, "trained_with_condition_dropout", False)
    unguided, notes = made(1.0)
    assert notes == ()
    for guidance in (0.0, 4.0, 15.0):
        image, notes = made(guidance)
        assert np.array_equal(image, unguided)
        assert notes == (NO_CONDITION_DROPOUT,)


def test_equal_seeds_give_equal_bytes(net):
    first, again, other = (
        sample_image(net, SHOWN, LatentParams(steps=4, seed=seed))[0] for seed in (3, 3, 4)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 20, 200])
@pytest.mark.parametrize("guidance", [0.0, 2.54, 15.0])
def test_any_number_of_steps_gives_an_image(net, steps, guidance):
    found, _ = sample_image(net, SHOWN, LatentParams(steps=steps, guidance=guidance))
    assert found.shape == (3, 32, 32)
    assert np.isfinite(found).all()


def test_sampling_can_be_cancelled_between_steps(net):
    class After:
        def __init__(self):
            self.n = 0

        def step(self, fraction, text):
            self.n += 1
            if self.n > 5:
                raise Cancelled

    with pytest.raises(Cancelled):
        sample_image(net, SHOWN, LatentParams(steps=200), After())


def test_imprint_encoding_is_invertible():
    imprint = np.linspace(*BUBBLE_FORMAT.image_range, 64, dtype=np.float32).reshape(1, 8, 8)
    shown = encode_image(imprint, "bubble")
    assert shown.shape == (3, 8, 8)
    assert (shown.min(), shown.max()) == (-1.0, 1.0)
    assert np.allclose(decode_image(shown, "bubble"), imprint, atol=1e-4)


@pytest.mark.parametrize(("trained_raw", "times"), [(False, 1.0), (True, 255.0)])
def test_the_condition_is_scaled_as_in_training_and_impossible_depths_are_left_to_physics(
    monkeypatch, trained_raw, times
):
    from pipeline.core.values.frames import TactileFrame
    from pipeline.physics import optics
    from pipeline.sensors import alignment

    gel = load_sensor("gelslim")
    bubble = load_sensor("soft_bubble")
    rest = optics.render_reference(gel)
    image = rest.copy()
    image[100:200, 100:250] = 255 - image[100:200, 100:250]
    seen = []
    monkeypatch.setattr(
        latent_diffusion,
        "sample_image",
        lambda _net, shown, *_: (seen.append(shown) or np.zeros((3, 32, 32), np.float32), ()),
    )
    network = SimpleNamespace(
        side=32,
        condition="image",
        raw_condition=trained_raw,
        half_turn=False,
    )
    frame = TactileFrame(sensor="gelslim", image=image, reference=rest)
    params = LatentParams()
    both = alignment.resolve_alignment(gel, bubble)
    view, found = estimate_views(frame, gel, both, bubble)
    reads = frame, found, gel, None, both, bubble, view
    touch = latent_diffusion.generate_touch(*reads, network, params)
    assert latent_diffusion.OUTSIDE_VIEW in touch.notes
    plain = latent_diffusion.resize_to_square(
        gel.sensor_kind.compute_relative_change(image, rest), 32
    )
    assert np.allclose(seen[0], normalise(times * plain, "gel"), atol=1e-4)
    monkeypatch.setattr(
        latent_diffusion, "sample_image", lambda *_: (np.ones((3, 32, 32), np.float32), ())
    )
    impossible = latent_diffusion.generate_touch(*reads, network, params)
    assert isinstance(impossible, Fallback), (
        "22.5 mm into the bubble: the gel cannot be pressed so far"
    )
    assert "another alignment" in impossible.reason
    assert impossible.result.membrane is not None
    network.trained_on_recordings = True
    known = latent_diffusion.generate_touch(*reads, network, params)
    assert not isinstance(known, Fallback), "recorded pairs know how the sensors lie"


@pytest.fixture(scope="module")
def contact_view():
    """A target depth on a GelSlim: a square that a source sees in the middle of half the image."""
    gel = load_sensor("gelslim")
    indentation = np.zeros(gel.camera.shape, np.float32)
    in_view = np.zeros(gel.camera.shape, np.bool_)
    indentation[140:180, 190:240] = 0.5
    in_view[:, 100:320] = True
    return TargetDepth(
        depth_mm=freeze((gel.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(indentation > 0),
        indentation_mm=freeze(indentation),
        camera=gel.camera,
        in_view=freeze(in_view),
        source_index=freeze(np.full(gel.camera.shape, -1, np.int32)),
    )


def make_depth_weights(**config):
    torch.manual_seed(0)
    config = {
        "side": 32,
        "width": 8,
        "channel_multipliers": "1 2",
        "blocks": 1,
        "attention": "2",
        "heads": 2,
        "groups": 4,
        "autoencoder_width": 8,
        "autoencoder_multipliers": "1 1 2 2",
        "autoencoder_blocks": 1,
        "condition_channels": 4,
        "condition": "depth",
        **config,
    }
    net = LatentDiffusion(**config)
    with torch.no_grad():
        net.model["diffusion_model"].out[2].weight.normal_(0, 0.02)
    tensors = {name: tensor.numpy() for name, tensor in net.state_dict().items()}
    return Weights(
        name="test", kind="latent", config=config, tensors=tensors, card={"task": "latent"}
    )


@pytest.mark.parametrize("leading", [False, True])
def test_the_times_are_those_of_the_weights_unless_chosen(leading):
    network = load_network(make_depth_weights(leading_times=leading))
    by_times = {
        times: sample_image(network, SHOWN, LatentParams(steps=3, guidance=1.0, times=times))[0]
        for times in ("as trained", "leading", "trailing")
    }
    assert np.array_equal(by_times["as trained"], by_times["leading"]) == leading
    assert np.array_equal(by_times["as trained"], by_times["trailing"]) != leading


def run_from_depth(view, weights, **params):
    graph = Graph(BUILT_IN.methods("t2d2", {"touch": "latent_t2d2"}))
    given = {
        "target_depth": view,
        "target": load_sensor("gelslim"),
        "touch_weights": weights,
        "previous_membrane": None,
    }
    return graph.evaluate(["touch"], given, {"touch": LatentParams(steps=5, **params)})["touch"]


def test_a_touch_from_depth_has_the_bytes_of_its_seed(contact_view):
    weights = make_depth_weights()
    first, again, other = (
        run_from_depth(contact_view, weights, seed=seed).output for seed in (1, 1, 2)
    )
    assert first.image.shape == (*contact_view.camera.shape, 3)
    assert np.array_equal(first.image, again.image)
    assert not np.array_equal(first.image, other.image)
    assert first.membrane is None
    assert latent_diffusion.OUTSIDE_VIEW not in first.notes  # a gel sees no more than its source


def test_the_condition_from_depth_is_depth_mask_and_view(contact_view):
    """D_T'' in contact, M_T'' and the source's view as area means, whose sums are those of the
    fields.
    """
    view = contact_view
    square = build_depth_square("gel", view.indentation_mm, view.contact, view.in_view, 32)
    assert square.shape == (3, 32, 32)
    assert square[1].mean() == pytest.approx(view.contact.mean(), rel=1e-4)
    assert square[2].mean() == pytest.approx(view.in_view.mean(), rel=1e-4)
    assert np.allclose(square[0], square[0].max() * square[1] / square[1].max(), atol=1e-6)
    assert not (square[1] > square[2] + 1e-6).any()


def test_a_target_depth_without_contact_or_weights_is_left_to_physics(contact_view):
    empty = np.zeros(contact_view.camera.shape, np.bool_)
    still = replace(
        contact_view, contact=freeze(empty), indentation_mm=freeze(empty.astype(np.float32))
    )
    assert run_from_depth(still, make_depth_weights()).state == "skipped"
    lacking = [
        BUILT_IN.method("touch", name).weights(load_sensor("gelslim"), load_sensor(target), None)
        for name in ("latent", "latent_t2d2")
        for target in ("soft_bubble", "gelslim")
    ]
    assert {weights.why for weights in lacking} == {latent_diffusion.NOT_SHIPPED}
    found = run_from_depth(contact_view, lacking[0])
    assert f"no network for this pair; {latent_diffusion.NOT_SHIPPED}" in found.fallback
    assert found.output.membrane.contact.any()


def test_weights_of_the_other_condition_are_refused(tmp_path):
    gel = load_sensor("gelslim")
    bubble = load_sensor("soft_bubble")
    depth_file = tmp_path / "depth.safetensors"
    image_file = tmp_path / "image.safetensors"
    save_weights(depth_file, make_depth_weights())
    save_weights(image_file, make_depth_weights(condition="image"))
    refused = latent_diffusion.select_weights(bubble, gel, depth_file)
    assert isinstance(refused, NoWeights)
    assert "from a target depth" in refused.why
    assert isinstance(latent_diffusion.select_t2d2_weights(bubble, gel, image_file), NoWeights)
    assert isinstance(latent_diffusion.select_t2d2_weights(bubble, gel, depth_file), Weights)
