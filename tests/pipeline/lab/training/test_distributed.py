"""Several processes train as one with the sum of their batches.

Networks in 16 bits give output in 32.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from pipeline.lab.training import run_folder as state
from pipeline.lab.training.distributed import wrap_precision
from pipeline.lab.training.loop import TrainingRun, train
from pipeline.lab.training.recipe import load_recipe
from pipeline.stages.networks.weights import load_weights
from tests.pipeline.lab.training import toy
from tests.pipeline.lab.training.test_loop import LONG_S, PROGRAM, ROOT

# relative: the order of sums, through twenty steps of an optimiser that divides by small numbers
ROUNDING = 2e-3


@pytest.mark.timeout(2 * LONG_S)
def test_two_processes_train_as_one_with_twice_the_batch(recipe_file, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    short = toy.RECIPE.replace("steps = 60", "steps = 25")
    recipe_file.write_text(short)
    out = tmp_path / "two"
    command = [sys.executable, program, "--recipe", recipe_file, "--out", out, "--workers", "0"]
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    of_both = {  # what torchrun sets, without the time that it takes to start
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
    }
    processes = [
        subprocess.Popen(
            command, env={**of_both, "RANK": rank, "LOCAL_RANK": rank}, stderr=subprocess.PIPE
        )
        for rank in ("0", "1")
    ]
    said = [process.communicate(timeout=LONG_S)[1] for process in processes]
    assert [process.returncode for process in processes] == [0, 0], said
    recipe_file.write_text(short.replace("batch = 4", "batch = 8"))
    whole = train(
        TrainingRun(recipe=load_recipe(str(recipe_file)), folder=tmp_path / "one", n_workers=0)
    )
    two = state.load_state(out)
    assert (two.step, two.n_examples) == (whole.step, whole.n_examples) == (25, 200)
    np.testing.assert_allclose(two.curve[0]["loss"], whole.curve[0]["loss"], rtol=ROUNDING)
    for name, tensor in whole.averaged_tensors.items():
        np.testing.assert_allclose(
            two.averaged_tensors[name],
            tensor,
            rtol=ROUNDING,
            atol=ROUNDING * float(tensor.abs().max()),
        )
    assert Path(out / "weights.safetensors").is_file()
    assert load_weights(out / "weights.safetensors").card["examples seen"] == "200"


def test_a_network_in_16_bits_has_output_and_gradients_in_32():
    class Two(nn.Module):
        def __init__(self):
            super().__init__()
            self.line = nn.Linear(4, 4)

        def forward(self, x):
            y = self.line(x)
            seen.append(y.dtype)
            return {"a": y, "b": (y, y > 0)}

    seen = []
    net = Two()
    x = torch.randn(3, 4)
    exact = net(x)["a"]
    rough = wrap_precision(net, "bf16", torch.device("cpu"))(x)
    assert seen == [torch.float32, torch.bfloat16]
    assert rough["a"].dtype == rough["b"][0].dtype == torch.float32
    assert rough["b"][1].dtype == torch.bool
    assert 0 < (rough["a"] - exact).abs().max() < 0.05
    rough["a"].sum().backward()
    assert net.line.weight.grad.dtype == torch.float32
    assert wrap_precision(net, "float32", torch.device("cpu")) is net
