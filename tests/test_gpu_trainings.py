"""The trainings held ready for a GPU run everywhere in two tiny steps, continue, and write weights
that their methods take.
"""

import runpy
from pathlib import Path

import pytest

from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.weights import Weights
from pipeline.translation.catalogue import BUILT_IN

GPU = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "gpu.py"))
FILES = {
    "latent_t2d2": (
        ("touch", "latent_t2d2", "digit", "soft_bubble", "latent_t2d2_soft_bubble"),
        ("touch", "latent_t2d2", "digit", "gelslim", "latent_t2d2_gelslim"),
    ),
    "latent_t2t": (
        ("touch", "latent", "gelslim", "soft_bubble", "latent_gelslim_to_soft_bubble"),
        ("touch", "latent", "soft_bubble", "gelslim", "latent_soft_bubble_to_gelslim"),
    ),
    "depth_anything": (
        ("depth", "depth_anything", "gelslim", "soft_bubble", "depth_anything_gelslim"),
    ),
}


@pytest.mark.timeout(600)
def test_trainings_run_continue_and_write_weights(tmp_path):
    for job, files in FILES.items():
        GPU["main"]([job, str(tmp_path), "--smoke"])
        for stage, method, source, target, name in files:
            file = tmp_path / f"{name}.safetensors"
            choose = BUILT_IN.method(stage, method).weights
            found = choose(load_sensor(source), load_sensor(target), file)
            assert isinstance(found, Weights), found
            assert found.card["steps"] == "2"
    state = tmp_path / "latent_t2d2_gelslim"
    before = {path.name: path.read_bytes() for path in state.glob("*.csv")}
    GPU["main"](["latent_t2d2", str(tmp_path), "--smoke"])  # done: nothing is trained again
    assert {path.name: path.read_bytes() for path in state.glob("*.csv")} == before


def test_they_are_as_large_as_they_say():
    """10 to 30 million parameters, and at most 20 MB in 16 bits for Depth Anything."""
    import torch

    from pipeline.stages.networks.network_factory import build_network

    for target in GPU["TARGETS"]:
        network = dict(GPU["_enlarge"]("latent_t2d2", target, smoke=False).network)
        with torch.device("meta"):
            net = build_network(network.pop("kind"), network)
        assert 10e6 < sum(p.numel() for p in net.parameters()) < 30e6
        assert net.side // 8 == 16
    with torch.device("meta"):
        net = build_network("depth_anything", GPU["DEPTH"])
    assert net.mask_head is not None
    assert 2 * sum(p.numel() for p in net.parameters()) < 20e6
