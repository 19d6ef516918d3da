"""Samples of networks are the same bytes on one thread and on two, as a process is started with
them.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.core.digests import compute_digest
from pipeline.stages.networks.network_factory import load_network, reproducible_inference
from pipeline.stages.networks.weights_registry import load_shipped
from pipeline.stages.touch.latent_diffusion import LatentParams, sample_image
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from tests.pipeline.stages.test_latent_diffusion_touch import make_depth_weights

ROOT = Path(__file__).resolve().parents[4]


def compute_sample_digests() -> str:
    rng = np.random.default_rng(3)
    compact, latent = (
        load_network(weights) for weights in (load_shipped("t2d2_gelslim"), make_depth_weights())
    )
    residual = sample_residual(
        compact, rng.normal(size=(6, 160, 214)).astype(np.float32), DiffusionParams(steps=2)
    )
    square = rng.normal(size=(3, latent.side, latent.side)).astype(np.float32)
    image, _ = sample_image(latent, square, LatentParams(steps=2))
    return f"{compute_digest(residual)} {compute_digest(image)}"


def test_samples_do_not_depend_on_the_threads_of_a_process():
    on_two = subprocess.run(
        [sys.executable, "-m", __name__],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert on_two.stdout.strip() == compute_sample_digests()


def test_the_number_of_threads_comes_back_after_an_error():
    before = torch.get_num_threads()

    def fail():
        with reproducible_inference(before + 1):
            assert torch.get_num_threads() == before + 1
            assert torch.is_inference_mode_enabled()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert torch.get_num_threads() == before


if __name__ == "__main__":
    sys.stdout.write(compute_sample_digests())
