"""Networks elsewhere: the choice, the key, and values within a tolerance. A card is needed for
`make gpu` alone.
"""

import numpy as np
import pytest
import torch

from pipeline.core.digests import compute_digest
from pipeline.core.errors import SettingProblem
from pipeline.stages.networks import devices
from pipeline.stages.networks.devices import PROCESSOR, check_device, choose_placement
from pipeline.stages.networks.latent_diffusion import LatentDiffusion
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.weights import Weights
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image
from tests.pipeline.stages.networks.test_latent_diffusion import SMALL

LARGE, COMPACT = 300_000_000, 1_000_000
BFLOAT16 = "cpu bfloat16"
TOLERANCE = 0.02  # of the range of an image, mean over it: bfloat16 has 8 bits
HAS_CARD = torch.cuda.is_available()


@pytest.fixture(scope="module")
def weights():
    torch.manual_seed(0)
    tensors = {name: t.numpy().copy() for name, t in LatentDiffusion(**SMALL).state_dict().items()}
    return Weights(name="small", kind="latent", config=SMALL, tensors=tensors)


def sample(weights):
    condition = np.random.default_rng(0).standard_normal((3, 32, 32)).astype(np.float32)
    return sample_image(load_network(weights), condition, LatentParams(steps=4, guidance=2.0))[0]


@pytest.mark.parametrize(
    ("asked", "n_parameters", "by_opencv", "there", "chosen"),
    [
        ("auto", LARGE, False, ("cpu", "cuda:0", "cuda"), "cuda bfloat16"),
        ("auto", COMPACT, False, ("cpu", "cuda:0", "cuda"), PROCESSOR),
        ("auto", LARGE, False, ("cpu",), PROCESSOR),
        ("auto", LARGE, True, ("cpu", "cuda:0", "cuda"), PROCESSOR),
        ("cuda:1", COMPACT, False, ("cpu",), "cuda:1 float32"),
        ("cpu", LARGE, False, ("cpu", "cuda:0", "cuda"), PROCESSOR),
        ("mps", LARGE, False, ("cpu", "mps"), "mps bfloat16"),
    ],
)
def test_published_sizes_go_to_a_card(asked, n_parameters, by_opencv, there, chosen, monkeypatch):
    monkeypatch.setattr(devices, "list_devices", lambda: there)
    assert choose_placement(asked, n_parameters, by_opencv=by_opencv) == chosen


@pytest.mark.parametrize("asked", ["gpu", "cuda:9", "cuda:x", "", "CPU", "float16"])
def test_a_device_that_is_not_there_is_one_sentence(asked):
    with pytest.raises(SettingProblem, match=r"no device .*\(--device\): (auto, )?cpu"):
        check_device(asked)


def test_half_precision_is_near_and_has_a_key_of_its_own(weights):
    placed = weights.place(BFLOAT16)
    assert compute_digest(placed) != compute_digest(weights)
    assert weights.place(PROCESSOR) is weights
    exact, half = sample(weights), sample(placed)
    assert half.dtype == np.float32
    apart = np.abs(exact - half).mean() / np.ptp(exact)
    assert 0 < apart < TOLERANCE


def test_too_little_memory_is_one_sentence_with_what_to_try(weights, monkeypatch):
    network = load_network(weights.place(BFLOAT16))

    def fail(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB\nand more")

    monkeypatch.setattr(network._net, "predict_noise", fail)
    with pytest.raises(SettingProblem, match=r"out of memory.*2 GiB\).*--device cpu"):
        sample(weights.place(BFLOAT16))


@pytest.mark.gpu
@pytest.mark.skipif(not HAS_CARD, reason="no card")
@pytest.mark.parametrize(("placement", "most"), [("cuda float32", 1e-3), ("cuda bfloat16", 0.02)])
def test_a_card_computes_what_the_processor_does(placement, most, weights):
    exact, there = sample(weights), sample(weights.place(placement))
    assert np.abs(exact - there).mean() / np.ptp(exact) < most
