"""Touch by latent diffusion: seeds, guidance, cancelling, conversion to mm, and two quirks of the released code."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pipeline.base.progress import Cancelled
from pipeline.networks.guidance import NO_CONDITION_DROPOUT
from pipeline.networks.latent_diffusion import LatentDiffusion
from pipeline.networks.square_images import MAX_IMPRINT_MM, MIN_IMPRINT_MM, decode_image, encode_image, normalise
from pipeline.stages.touch import latent_diffusion
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image

SHOWN = np.random.default_rng(0).normal(size=(3, 32, 32)).astype(np.float32)


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    made = LatentDiffusion(
        side=32, width=8, channel_multipliers="1 2", blocks=1, attention="2", heads=2, groups=4, autoencoder_width=8,
        autoencoder_multipliers="1 1 2 2", autoencoder_blocks=1, condition_channels=4,
    )  # fmt: skip
    with torch.no_grad():
        made.model["diffusion_model"].out[2].weight.normal_(0, 0.02)
    return made.eval().requires_grad_(False)


def counted(net, monkeypatch):
    calls = []
    plain = type(net).predict_noise
    monkeypatch.setattr(type(net), "predict_noise", lambda self, *a: calls.extend(a[2]) or plain(self, *a))
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
    first, again, other = (sample_image(net, SHOWN, LatentParams(steps=4, seed=seed))[0] for seed in (3, 3, 4))
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
    imprint = np.linspace(MIN_IMPRINT_MM, MAX_IMPRINT_MM, 64, dtype=np.float32).reshape(1, 8, 8)
    shown = encode_image(imprint, "bubble")
    assert shown.shape == (3, 8, 8)
    assert (shown.min(), shown.max()) == (-1.0, 1.0)
    assert np.allclose(decode_image(shown, "bubble"), imprint, atol=1e-4)
    twice = decode_image(shown, "bubble", map_twice=True)
    assert twice.min() == pytest.approx(0.5 * (MIN_IMPRINT_MM + MAX_IMPRINT_MM))  # the released scripts' upper half
    assert twice.max() == pytest.approx(MAX_IMPRINT_MM)


def test_generated_imprints_are_renormalised():
    made = np.random.default_rng(1).normal(2.0, 3.0, (1, 64, 64)).astype(np.float32)
    found = latent_diffusion._renormalise_depth(made, (2.0, 3.0), (4.0, 6.0))
    assert (float(found.mean()), float(found.std())) == pytest.approx((4.0, 6.0), abs=0.2)
    assert np.array_equal(latent_diffusion._renormalise_depth(made, (2.0, 0.0), (4.0, 6.0)), made)


@pytest.mark.parametrize(("setting", "trained_raw", "times"), [
    ("as trained", False, 1.0), ("as trained", True, 255.0), ("yes", False, 255.0), ("no", True, 1.0),
])  # fmt: skip
def test_the_condition_is_scaled_as_in_training(monkeypatch, setting, trained_raw, times):
    from pipeline.physics import optics
    from pipeline.sensors import alignment
    from pipeline.sensors.spec import load_sensor
    from pipeline.values.frames import TactileFrame

    gel, bubble = load_sensor("gelslim"), load_sensor("soft_bubble")
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
        side=32, raw_condition=trained_raw, half_turn=False, generated_stats=(0.0, 0.0), true_stats=(0.0, 0.0)
    )
    frame = TactileFrame(sensor="gelslim", image=image, reference=rest)
    params = LatentParams(raw_condition=setting)
    latent_diffusion.generate_touch(frame, gel, None, alignment.resolve_alignment(gel, bubble), bubble, network, params)
    plain = latent_diffusion.resize_to_square(latent_diffusion.compute_change("gel", image, rest), 32)
    assert np.allclose(seen[0], normalise(times * plain, "gel"), atol=1e-4)
