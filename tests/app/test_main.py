"""How the window starts."""

from __future__ import annotations

from pathlib import Path

from app.main import SAMPLE, SAMPLE_TOUCH, _first_frame
from pipeline.recordings import open_recording
from pipeline.translation.translate import Request


def test_the_sample_opens_on_its_first_touch_and_other_recordings_on_their_first_frame(tmp_path, monkeypatch):
    stream = open_recording(SAMPLE).stream("gelslim")
    touched = [stream.truth(frame).contact.any() for frame in range(SAMPLE_TOUCH + 1)]
    assert touched == [False] * SAMPLE_TOUCH + [True]
    monkeypatch.chdir(SAMPLE.parent)
    here = Request(recording=Path(SAMPLE.name), target="")
    assert _first_frame(None) == _first_frame(here) == SAMPLE_TOUCH
    assert _first_frame(Request(recording=tmp_path / "other.h5", target="")) == 0
