"""Nothing that one can press breaks the simulator: the short form of benchmarks/random_presses.py."""

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "random_presses.py"


@pytest.fixture(scope="module")
def presses():
    spec = importlib.util.spec_from_file_location("random_presses", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def failures(presses, n, seed):
    counts, _, _, told = presses.run(n, seed)
    assert sum(counts.values()) == n
    return [line for line in told if "FAILED" in line]


def test_sixty_random_presses_break_nothing(presses):
    assert failures(presses, 60, seed=2) == []


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_ten_thousand_random_presses_break_nothing(presses):
    assert failures(presses, 10_000, seed=3) == []


def test_a_broken_answer_is_noticed(presses):
    """The check itself: a truth with a NaN in it must be called a failure."""
    from dataclasses import replace

    import numpy as np

    spec = presses.small_sensor("digit", 0.125)
    pressed = presses.press(presses.catalogue()[0], np.eye(4), spec, seed=1)
    assert presses.contradiction(pressed, spec) == ""
    moved = pressed.truth.indentation_mm.copy()
    moved[3, 3] = np.nan
    assert "finite" in presses.contradiction(replace(pressed, truth=replace(pressed.truth, indentation_mm=moved)), spec)
