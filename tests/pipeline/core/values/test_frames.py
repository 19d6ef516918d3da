"""Recordings find their streams and the transforms between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import Pairing, Recording, Stream, TactileFrame

FLOAT64_MM = 1e-9  # rounding of a product of two transforms below 100 mm


def stream(name: str, sensor: str) -> Stream:
    return Stream(
        name=name,
        sensor=sensor,
        n_frames=1,
        frame=lambda i: TactileFrame(
            sensor=sensor, image=np.zeros((2, 3, 3), np.uint8), reference=None, index=i
        ),
    )


PAIR = Pairing(
    source="left",
    target="bubble",
    target_from_source=rigid.from_parts((1.0, 2.0, 3.0), (0.0, 40.0, 0.0)),
)
RECORDING = Recording(
    path=Path("x"),
    format="made up",
    streams=(stream("left", "gelslim"), stream("bubble", "soft_bubble")),
    pairings=(PAIR,),
)


def test_a_stream_is_found_by_name_or_sensor_and_the_first_without_either():
    assert RECORDING.stream("bubble").name == RECORDING.stream("soft_bubble").name == "bubble"
    assert RECORDING.stream().name == "left"
    assert RECORDING.stream_of_sensor("digit") is None


def test_a_missing_stream_names_the_existing_ones():
    with pytest.raises(
        SettingProblem,
        match=r"no stream 'nose' in this recording; it has 'bubble' of soft_bubble, 'left' of "
        r"gelslim; choose",
    ):
        RECORDING.stream("nose")


def test_a_pairing_is_known_both_ways():
    there = RECORDING.target_from_source("left", "bubble")
    back = RECORDING.target_from_source("bubble", "left")
    np.testing.assert_allclose(there @ back, np.eye(4), atol=FLOAT64_MM)
    assert RECORDING.target_from_source("left", "digit") is None


def test_depth_and_colour_are_distinguished_by_shape():
    assert not RECORDING.streams[0].frame(0).is_depth
    assert TactileFrame(
        sensor="soft_bubble", image=np.zeros((2, 3), np.float32), reference=None
    ).is_depth


def test_a_stream_has_no_truth_by_default():
    assert RECORDING.streams[0].truth(0) is None
    assert not RECORDING.streams[0].has_truth
