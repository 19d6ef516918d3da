"""Touches of the sample recording, to be stored in other ways."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from pipeline.io import open_recording

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"


class Touches(NamedTuple):
    """Images of a GelSlim: untouched ones first and last."""

    reference: np.ndarray  # (rows, cols, 3)
    images: np.ndarray  # (frames, rows, cols, 3)


@pytest.fixture(scope="session")
def touches() -> Touches:
    recording = open_recording(SAMPLE)
    stream = recording.stream_of_sensor("gelslim")
    assert stream is not None
    frames = [stream.frame(index) for index in range(stream.n_frames)]
    recording.close()
    return Touches(frames[0].reference, np.stack([frame.image for frame in frames]))
