"""Names of motions that a contact does not show."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.geometry.screws import describe_motions

# What the first sample's elbow leaves open on a bubble: columns of (rotation times 4.2 mm,
# translation in mm).
_SLIDE = np.array([-0.03, 0.04, 0.0, 0.08, 0.99, -0.02])
_TURN = np.array([0.015, 0.007, 0.777, -0.5, 0.04, 0.0])


@pytest.mark.parametrize(
    ("slide_is_lost", "first"), [(True, "moves along (0.0"), (False, "rotates about (-")]
)
def test_a_slide_that_hardly_turns_is_called_a_slide_where_it_is_open_without_the_turn(
    slide_is_lost, first
):
    lost, _ = np.linalg.qr(np.column_stack([_SLIDE, _TURN]))

    def is_lost(motion):
        return slide_is_lost or bool(np.linalg.norm(motion[:3]) > 0.01)

    words = [name for name, _ in describe_motions(lost, np.array([-0.6, 0.2, 75.7]), 4.2, is_lost)]
    assert any(name.startswith(first) for name in words), words
    if slide_is_lost:
        assert words[1] == "rotates about z with its axis at (-0.8, -2.5, 75.7) mm"
