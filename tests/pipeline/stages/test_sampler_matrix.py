"""Steps times guidance over all shipped networks that sample, and latent ones with and without
condition dropout: finite, and guided.

Guidance acts from four steps on, and only where a network was trained without its condition, too.
"""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.samplers import MAX_STEPS, MAX_WEIGHT, NO_CONDITION_DROPOUT
from pipeline.stages.networks.weights import load_weights
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from tests.pipeline.stages.test_latent_diffusion_touch import make_depth_weights

SAMPLING_KINDS = ("residual_denoiser", "latent")
SHIPPED = [
    path.stem
    for path in sorted(weights_registry.WEIGHTS_FOLDER.glob("*.safetensors"))
    if path.stem.startswith(("t2d2_", "t2t_"))
]
LATENT = {"latent": True, "latent without condition dropout": False}  # as the lab's
GUIDED_STEPS = 4


def load(name):
    if name in LATENT:
        return make_depth_weights(trained_with_condition_dropout=LATENT[name])
    weights = load_weights(weights_registry.WEIGHTS_FOLDER / f"{name}.safetensors")
    assert weights.kind in SAMPLING_KINDS
    return weights


def sample_once(weights, steps, guidance):
    """A sample of a random condition, and the notes."""
    network = load_network(weights)
    rng = np.random.default_rng(0)
    if weights.kind == "latent":
        condition = rng.standard_normal(
            (weights.config.get("condition_inputs", 3), network.side, network.side)
        )
        return sample_image(
            network, condition.astype(np.float32), LatentParams(steps=steps, guidance=guidance)
        )
    condition = rng.standard_normal((network.inputs, 16, 24)).astype(np.float32)
    found = sample_residual(network, condition, DiffusionParams(steps=steps, guidance=guidance))
    return np.stack([found.final.residual_mm, found.final.contact_correction]), found.notes


def check_cells(name, all_steps, guidances):
    weights = load(name)
    for steps in all_steps:
        cells = {guidance: sample_once(weights, steps, guidance) for guidance in guidances}
        assert all(np.isfinite(sample).all() for sample, _ in cells.values())
        acts = weights.trained_with_condition_dropout and steps >= GUIDED_STEPS
        assert np.array_equal(cells[1.0][0], cells[4.0][0]) != acts, (steps, "guidance 1 and 4")
        if not weights.trained_with_condition_dropout:
            assert all(np.array_equal(sample, cells[1.0][0]) for sample, _ in cells.values())
            assert all(
                (notes == (NO_CONDITION_DROPOUT,)) == (guidance != 1.0)
                for guidance, (_, notes) in cells.items()
            )
        elif not acts:
            assert "without guidance" in cells[4.0][1][0]


def test_all_networks_that_sample_are_listed():
    kinds = {
        path.stem: load_weights(path).kind
        for path in weights_registry.WEIGHTS_FOLDER.glob("*.safetensors")
    }
    assert sorted(name for name, kind in kinds.items() if kind in SAMPLING_KINDS) == SHIPPED


@pytest.mark.parametrize("name", [*SHIPPED, *LATENT])
def test_few_cells(name):
    check_cells(name, (1, 3, 4, 9), (0.0, 1.0, 4.0, MAX_WEIGHT))


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", [*SHIPPED, *LATENT])
def test_the_whole_matrix(name):
    check_cells(name, (1, 2, 3, 4, 5, 8, 20, 200, MAX_STEPS), (0.0, 1.0, 4.0, MAX_WEIGHT))
