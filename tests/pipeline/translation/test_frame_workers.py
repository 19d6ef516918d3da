"""Frames of a live sensor on worker processes: the values of one process, in order, none invented."""

import math
import multiprocessing
import os
import signal
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tactoscope as ts
from pipeline.cli import live as live_command
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.errors import NotConverged, TouchError
from pipeline.core.shared_memory import SharedBlock
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.source import LiveFrame
from pipeline.io.mounts import mount, unmount
from pipeline.stages.stage import GroundTruth
from pipeline.translation import live_translation
from pipeline.translation.live_rate import RatePlan
from pipeline.translation.live_translation import LiveTranslation
from pipeline.translation.translate import Request, open_translation
from sample_data.make_samples import RECORDINGS_FOLDER

LIVE = Path("live:/workers")
STALE_S = 0.5


@dataclass
class RecordedSource:
    """The frames of a recording as a live sensor: its reference, then its touches."""

    path: Path
    sensor: str
    title: str = "a recorded sensor"
    touching_object: None = None
    images: list = field(default_factory=list)
    _n: int = 0

    def open(self) -> None:
        opened = open_translation(Request(recording=self.path, target="gelslim"))
        frames = [opened.stream.frame(k) for k in range(opened.n_frames)]
        self.images = [f.image for f in frames if opened.stream.truth(f.index).contact.any()]
        self.reference = frames[0].reference

    def read(self) -> LiveFrame | None:
        time.sleep(0.05)
        self._n += 1
        image = self.images[self._n % len(self.images)] if self._n > 20 else self.reference
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=self._n)

    def close(self) -> None:
        pass


def poll_for(live, seconds):
    ends_s = time.monotonic() + seconds
    while time.monotonic() < ends_s:
        live.poll(0.2)


@pytest.mark.timeout(300)
def test_a_live_sensor_is_translated_in_order_with_the_values_of_one_process(monkeypatch):
    """In the light of the touches so far, once there are enough, which the frame tells."""
    monkeypatch.setattr(live_translation, "_KEPT_TOUCHES", 3)
    reader = LiveReader(RecordedSource(RECORDINGS_FOLDER / "digit_gelslim.h5", "digit"))
    mount(LIVE, lambda: reader.make_recording(LIVE))
    reader.start()
    while not reader.has_reference:
        time.sleep(0.01)
    translation = open_translation(Request(recording=LIVE, target="gelslim"))
    live = LiveTranslation(translation, reader, n_workers=2)
    shown = []
    started_s = time.monotonic()
    try:
        while len(shown) < 6 or not (
            any(
                not np.array_equal(i, shown[-1].frame.image) for i in shown[-1].frame.context_frames
            )
            and shown[-1].results["depth"].output.contact.any()
        ):
            shown += live.poll(0.2)
            assert not live.problem
            assert time.monotonic() - started_s < 200.0
        os.kill(multiprocessing.active_children()[-1].pid, signal.SIGKILL)
        with pytest.raises(NotConverged, match="worker process died"):
            poll_for(live, 50.0)
    finally:
        live.close()
        reader.stop(5.0)
        unmount(LIVE)
    numbers = [one.frame.index for one in shown]
    assert numbers == sorted(set(numbers))
    assert all(one.age_s > 0 for one in shown)
    last = shown[-1]
    here = translation.evaluate(last.frame)
    assert list(last.results) == list(here)
    for name, result in here.items():
        assert last.results[name].method is result.method
        if name != "pose":
            assert last.results[name].digest == result.digest
    assert 1 <= len(last.frame.context_frames) <= 3
    depth_mm = last.results["depth"].output.depth_mm
    assert depth_mm.tobytes() == here["depth"].output.depth_mm.tobytes()
    assert not depth_mm.flags.writeable


@pytest.mark.timeout(300)
def test_a_live_sensor_is_a_loop_in_python():
    before = set(multiprocessing.active_children())
    for shown in ts.live("simulated", "gelslim", sensor="digit"):
        assert shown.results["touch"].output.image.shape == (320, 427, 3)
        assert set(multiprocessing.active_children()) > before
        break
    ends_s = time.monotonic() + 20.0
    while set(multiprocessing.active_children()) - before:
        assert time.monotonic() < ends_s, "a worker outlives its loop"
    with pytest.raises(TouchError, match="nose"):
        next(ts.live("simulated", "nose"))
    with pytest.raises(TouchError, match="source"):
        ts.live("a wish", "gelslim")
    with pytest.raises(TouchError, match="cuda:99"):
        ts.open(RECORDINGS_FOLDER / "digit_gelslim.h5", "gelslim", device="cuda:99")


def test_a_loop_over_a_sensor_that_is_not_there_ends_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(live_translation, "_PATIENCE_S", 0.1)
    with pytest.raises(TouchError, match=r"nothing for .*no folder '[^']*gone'$"):
        next(ts.live(f"folder {tmp_path / 'gone'}", "gelslim", sensor="digit"))
    for rate_hz in (-1.0, math.nan):
        with pytest.raises(TouchError, match="rate"):
            ts.live(f"folder {tmp_path}", "gelslim", sensor="digit", rate_hz=rate_hz)
    with pytest.raises(TouchError, match="device"):
        ts.open(RECORDINGS_FOLDER / "digit_gelslim.h5", "gelslim", device=None)


@pytest.mark.timeout(300)
def test_whoever_takes_frames_slowly_gets_the_newest_one():
    shown = ts.live("simulated", "gelslim", sensor="digit", rate_hz=15.0)
    with closing(shown):
        first = next(shown)
        time.sleep(4 * STALE_S)
        assert next(shown).frame.time_s - first.frame.time_s > 2 * STALE_S


def test_each_loop_has_a_recording_of_its_own(monkeypatch):
    monkeypatch.setattr(live_translation, "translate_live", lambda *given: given)
    (first, one, *_), (other, two, *_) = (ts.live("simulated", "digit") for _ in range(2))
    assert first is not other
    assert one.recording != two.recording


def test_a_block_holds_one_value_and_one_that_is_too_large_goes_through_the_pipe():
    block = SharedBlock(1 << 16)
    other = SharedBlock(name=block.name)
    try:
        for n in (0, 100, 1 << 14):
            value = {"a": np.arange(n, dtype=np.float32), "b": (np.ones((2, 3), bool), "text")}
            taken = other.take(block.put(value))
            assert taken["b"][1] == "text"
            assert taken["a"].tobytes() == value["a"].tobytes()
            assert taken["b"][0].all()
        kept = other.take(block.put(np.zeros(5)))
        block.put(np.ones(5))
        assert not kept.any(), "a copy"
    finally:
        other.close()
        block.close()


def test_the_status_of_a_live_translation_says_rate_age_and_what_is_left_out():
    plan = RatePlan(rate_hz=25.0, pose_every=3)
    shown = [SimpleNamespace(age_s=age_s, truth=GroundTruth()) for age_s in (0.06, 0.09, 0.05)]
    assert live_command._describe(SimpleNamespace(plan=plan, problem=""), shown, 0.5) == (
        "6.0 of 25 Hz translated, 60 ms old, at most 90, pose in every 3rd frame"
    )
    nothing = SimpleNamespace(plan=RatePlan(), problem="no depth: try another")
    assert live_command._describe(nothing, [], 1.0) == "0.0 Hz translated, no depth: try another"


@pytest.mark.parametrize(
    ("more", "said"), [(["--target", "nose"], "nose"), (["--rate", "1000"], "--rate")]
)
def test_a_wrong_target_or_rate_is_said_before_anything_starts(more, said, capsys):
    assert run_app(build_app(), ["live", "--seconds", "1", *more]) == EXIT_USER_ERROR
    assert said in capsys.readouterr().err
