"""An empty window loads what a first depth needs, and stops where somebody opens one."""

from __future__ import annotations

from app.document import preload
from app.document.preload import PreloadController, preload_depth
from app.session.sample import SAMPLE_RECORDING
from pipeline.core.progress import Cancelled
from pipeline.stages.depth import poisson

AS_USERS_HAVE_IT = True  # results that another test has computed load nothing


def test_an_empty_window_preloads(monkeypatch, qtbot, open_window):
    integrated = []
    monkeypatch.setattr(
        poisson,
        "integrate_slopes",
        lambda *given, whole=poisson.integrate_slopes: integrated.append(1) or whole(*given),
    )
    own = PreloadController(open_window())
    with qtbot.waitSignal(own.job.finished, timeout=240_000):
        assert own.start_timer.isActive()
        own.start_timer.setInterval(0)
    assert integrated, "it was no touch"


def test_opening_a_recording_stops_the_preload(monkeypatch, qtbot, open_window):
    def waits(report):
        while True:
            report.step(0.5, "waiting")

    monkeypatch.setattr(preload, "preload_depth", waits)
    controller = open_window()
    own = PreloadController(controller)
    own.start_timer.setInterval(0)
    qtbot.waitUntil(lambda: own.job.is_busy, timeout=240_000)
    with qtbot.waitSignal(own.job.cancelled, timeout=240_000):
        controller.open_path(SAMPLE_RECORDING)
    assert not own.start_timer.isActive()


def test_the_preload_does_not_delay_closing():
    class Impatient:
        def step(self, fraction, text):
            raise Cancelled

    try:
        preload_depth(Impatient())
    except Cancelled:
        return
    raise AssertionError("it went on")
