"""An empty window loads what a first depth needs, and stops where somebody opens one."""

from __future__ import annotations

from app.frame import warming
from app.frame.warming import Warming
from app.session.sample import SAMPLE
from app.work.warming import read_a_touch
from pipeline.base.progress import Cancelled
from pipeline.stages.depth import lit_surface


def test_an_empty_window_reads_a_touch_beforehand(monkeypatch, qtbot, open_window):
    integrated = []
    monkeypatch.setattr(
        lit_surface, "integrate", lambda *given, whole=lit_surface.integrate: integrated.append(1) or whole(*given)
    )
    own = Warming(open_window())
    with qtbot.waitSignal(own.job.finished, timeout=60_000):
        assert own.soon.isActive()
        own.soon.setInterval(0)
    assert integrated, "it was no touch"


def test_a_recording_that_is_opened_comes_first(monkeypatch, qtbot, open_window):
    def waits(report):
        while True:
            report.step(0.5, "waiting")

    monkeypatch.setattr(warming, "read_a_touch", waits)
    instrument = open_window()
    own = Warming(instrument)
    own.soon.setInterval(0)
    qtbot.waitUntil(lambda: own.job.busy, timeout=20_000)
    with qtbot.waitSignal(own.job.cancelled, timeout=20_000):
        instrument.open_path(SAMPLE)
    assert not own.soon.isActive()


def test_nobody_need_wait_for_it():
    class Impatient:
        def step(self, fraction, text):
            raise Cancelled

    try:
        read_a_touch(Impatient())
    except Cancelled:
        return
    raise AssertionError("it went on")
