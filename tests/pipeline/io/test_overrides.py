"""What a user says about a recording, in the place of what its file says."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.io.format_dispatch import with_sensor
from pipeline.io.hdf5_writer import RecordingWriter


def frame(sensor):
    return TactileFrame(sensor=sensor, image=np.full((4, 6, 3), 7, np.uint8), reference=None)


def recording(tmp_path, **streams):
    path = tmp_path / "a.h5"
    with RecordingWriter(path) as writer:
        for name, sensor in streams.items():
            writer.append(name, frame(sensor))
    return open_recording(path)


def list_sensors(recording):
    return [(s.sensor, s.frame(0).sensor) for s in recording.streams]


def test_the_only_stream_takes_the_stated_sensor_with_a_note(tmp_path):
    changed = with_sensor(recording(tmp_path, a="digit"), "gelslim")
    assert list_sensors(changed) == [("gelslim", "gelslim")]
    assert changed.notes[-1] == "the file names the sensor digit; gelslim is used instead"


def test_several_streams_keep_the_sensors_that_they_name(tmp_path):
    changed = with_sensor(recording(tmp_path, a="digit", b=""), "gelslim")
    assert list_sensors(changed) == [("digit", "digit"), ("gelslim", "gelslim")]
    assert not any("is used instead" in note for note in changed.notes)


@pytest.mark.parametrize("asked", ["", "digit"])
def test_an_equal_sensor_adds_no_note(tmp_path, asked):
    opened = recording(tmp_path, a="digit")
    changed = with_sensor(opened, asked)
    assert list_sensors(changed) == [("digit", "digit")]
    assert changed.notes == opened.notes
