"""Frames of sensor instances, and a network that predicts the scale of the depth."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.networks.gel_depth import GelDepthPrediction
from pipeline.networks.network_factory import build_network
from pipeline.stages.depth import gel_network_input, illumination_channels
from pipeline.training import instance_samples
from pipeline.training.gel_instances import GelInstancesTask, compute_loss, mirror_example
from pipeline.training.recipe import load_recipe

TASK = GelInstancesTask(n_frames=4)


def build_narrow_network(recipe):
    """The recipe's network, narrower."""
    config = {name: value for name, value in recipe.network.items() if name != "kind"}
    return build_network(recipe.network["kind"], {**config, "base_channels": 8, "max_channels": 16})


@pytest.fixture(scope="module")
def samples():
    return [instance_samples.simulate_instance_sample(3, index) for index in range(4)]


def test_a_sample_depends_on_its_index_and_is_stored_in_a_folder(samples, tmp_path):
    for _ in range(2):  # made and stored, then loaded
        instance_samples._samples.clear()
        instance_samples._simulate_press.cache_clear()
        sample = instance_samples.simulate_instance_sample(3, 1, str(tmp_path))
        assert np.array_equal(sample.fields, samples[1].fields)
        assert len(list(tmp_path.iterdir())) == 1
    assert not np.array_equal(samples[0].fields, samples[1].fields)


def test_samples_of_one_press_share_a_contact_and_differ_in_depth(samples):
    deepest = [float(one.indentation.max() * one.depth_mm) for one in samples[:3]]
    assert np.array_equal(samples[0].contact, samples[1].contact)
    assert np.array_equal(samples[0].contact, samples[2].contact)
    assert len({round(depth, 4) for depth in deepest}) == 3
    for one in samples:
        assert np.isfinite(one.fields).all()
        assert one.contact.any()
        assert one.indentation[one.contact].mean() > one.indentation[~one.contact].mean()


def test_mirroring_changes_the_sign_of_slopes_alone(samples):
    one = {"fields": samples[0].fields, "contact": samples[0].contact.astype(np.uint8)}
    for seed in range(6):
        mirrored = mirror_example(np.random.default_rng(seed), {k: v.copy() for k, v in one.items()})
        np.testing.assert_allclose(mirrored["fields"][19:], one["fields"][19:])
        np.testing.assert_allclose(
            np.abs(mirrored["fields"][:14]).sum((1, 2)), np.abs(one["fields"][:14]).sum((1, 2)), rtol=1e-4
        )
        place = mirrored["fields"][gel_network_input.POSITION_CHANNEL : gel_network_input.POSITION_CHANNEL + 2]
        np.testing.assert_allclose(
            place, one["fields"][gel_network_input.POSITION_CHANNEL : gel_network_input.POSITION_CHANNEL + 2], atol=1e-6
        )


def make_prediction(surface, log_scale):
    like = torch.zeros_like(surface)
    return GelDepthPrediction(surface=surface, correction=like, contact_logit=like, contact_logit_correction=like, log_error_scale=like,
                   log_depth_factor=log_scale)  # fmt: skip


def test_the_loss_is_smaller_at_the_true_scale():
    truth = torch.rand(2, 12, 16) + 0.5
    touched = torch.ones(2, 12, 16)
    factor = torch.tensor([0.8, 1.3])
    seen = truth / factor[:, None, None]
    right, _ = compute_loss(make_prediction(seen, factor.log()), truth, touched)
    wrong, parts = compute_loss(make_prediction(seen, torch.zeros(2)), truth, touched)
    assert float(right) < float(wrong) - 0.1
    assert set(parts) == {"surface", "slopes", "contact", "overlap", "spread"}


def test_metrics_of_an_untrained_network_equal_those_of_physics():
    network = build_narrow_network(load_recipe("gel_instances")).eval()
    found = TASK.evaluate(
        network, [TASK.make_validation_example("unseen_tools", 2), TASK.make_validation_example("unseen_grasps", 1)]
    )
    assert found["error in contact, um"] == pytest.approx(found["physics error in contact, um"], rel=0.02)
    assert 0.5 < found["contact IoU"] == pytest.approx(found["physics contact IoU"], abs=0.02)


def test_the_recipe_trains_the_scale_of_a_touch(samples):
    torch.manual_seed(0)
    recipe = load_recipe("gel_instances")
    assert recipe.network["inputs"] == illumination_channels.N_ALL_CHANNELS
    network = build_narrow_network(recipe)
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    fields = torch.from_numpy(np.stack([one.fields for one in samples]))
    truth = torch.from_numpy(np.stack([1.4 * one.indentation for one in samples]))
    touched = torch.from_numpy(np.stack([one.contact for one in samples]))
    losses = []
    for _ in range(12):
        loss, _ = TASK.compute_loss(network, {"fields": fields, "indentation": truth, "contact": touched})
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] - 0.1
    assert float(network(fields).log_depth_factor.detach().mean()) > 0.02
