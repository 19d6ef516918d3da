"""Random presses do not break the simulator."""

from dataclasses import replace

import numpy as np
import pytest

from tests.stability import random_presses as presses


def failures(n, seed):
    counts, _, _, lines = presses.run(n, seed)
    assert sum(counts.values()) == n
    return [line for line in lines if "FAILED" in line]


def test_sixty_random_presses_break_nothing():
    assert failures(60, seed=2) == []


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_ten_thousand_random_presses_break_nothing():
    assert failures(10_000, seed=3) == []


def test_a_broken_answer_is_noticed():
    """The check itself: a truth with a NaN in it is a failure."""
    spec = presses.small_sensor("digit", 0.125)
    pressed = presses.simulate_press(presses.catalogue()[0], np.eye(4), spec, seed=1)
    assert presses.contradiction(pressed, spec) == ""
    moved = pressed.truth.indentation_mm.copy()
    moved[3, 3] = np.nan
    assert "finite" in presses.contradiction(
        replace(pressed, truth=replace(pressed.truth, indentation_mm=moved)), spec
    )
