"""The test that decides whether a frame needs any work at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.values.frames import TactileFrame
from pipeline.physics.optics import render_reference as untouched_picture
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.change_detection import compute_block_change
from pipeline.stages.depth.photometric import DepthParams, skip_without_contact

BLOCK_PX = 8
MINI = load_sensor("gelsight_mini")


def largest_mean(image, reference):
    """Largest mean absolute change of whole blocks, in whole numbers throughout.

    Halves go to the even number.
    """
    rows, cols = (n // BLOCK_PX for n in image.shape[:2])
    change = np.abs(image.astype(np.int64) - reference)[: rows * BLOCK_PX, : cols * BLOCK_PX]
    total = change.reshape(rows, BLOCK_PX, cols, BLOCK_PX, 3).sum(axis=(1, 3))
    whole, rest = np.divmod(total, BLOCK_PX**2)
    half = BLOCK_PX**2 // 2
    return int((whole + ((rest > half) | ((rest == half) & (whole % 2 == 1)))).max())


@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(8, 60),
    cols=st.integers(8, 60),
    levels=st.integers(4, 256),
)
def test_the_largest_change_is_that_of_exact_block_means(seed, rows, cols, levels):
    rng = np.random.default_rng(seed)
    image, reference = rng.integers(0, levels, (2, rows, cols, 3), dtype=np.uint8)
    assert compute_block_change(image, reference, BLOCK_PX).max() == largest_mean(image, reference)


@pytest.mark.parametrize("shape", [(1, 1, 3), (3, 40, 3), (40, 3, 3), (7, 7, 3)])
def test_pictures_smaller_than_a_block_have_a_change_too(shape):
    reference = np.full(shape, 100, np.uint8)
    assert compute_block_change(reference + np.uint8(9), reference, BLOCK_PX).max() == 9.0


def test_untouched_frames_of_one_camera_share_one_result():
    still = untouched_picture(MINI)
    rng = np.random.default_rng(0)
    results = [
        skip_without_contact(
            TactileFrame(
                sensor=MINI.name,
                image=still ^ rng.integers(0, 2, still.shape, dtype=np.uint8),
                reference=still,
            ),
            MINI,
            None,
            DepthParams(),
        )
        for _ in range(3)
    ]
    assert results[0] is not None
    assert results[0] is results[1] is results[2]
