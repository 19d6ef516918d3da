"""How soon does a parameter that is dragged show in its own column, for every slider of every stage and each sensor?

Run under a display: python benchmarks/slider_previews.py [CASE ...], of `_cases`. A slider is held and moved a few
times; time is that of the processor, all threads, until the column of its stage shows the answer, which a busy machine
lengthens less. The promise: 100 ms. A gel of 1280 x 1708 pixels is a picture of the sample enlarged.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, Timing, build_measurement
from benchmarks.window_events import spin
from pipeline.racing.results import BenchmarkResult, Measurement
from pipeline.racing.text_report import print_result

NEEDS = "a display"
MOVES, ANSWER_MS = 4, 100.0
_WARM_UP = 2  # the first ones load and compile
_MANY = 20  # whole numbers of a smaller range have no slider
_LIMIT_S = 60.0
_LARGE = (1280, 1708)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Case:
    name: str
    session: dict[str, Any]


def measure(*only: str) -> BenchmarkResult:
    from app import main as app_main

    app_main.prepare_environment()
    application = app_main.make_application()
    from app.session.state import Session
    from app.window.tour import wait_until_shown

    told: list[str] = []
    rows: list[Measurement] = []
    with tempfile.TemporaryDirectory() as folder:
        cases = [case for case in _cases(app_main.SAMPLE_RECORDING, Path(folder)) if not only or case.name in only]
        instrument = app_main.show_window(Session(**cases[0].session))
        instrument.window.resize(1600, 950)
        for case in cases:
            instrument.show_session(Session(**case.session))
            wait_until_shown(instrument, _LIMIT_S)
            rows += [_row(case.name, *found, told) for found in _sliders(instrument, application)]
        instrument.window.may_close = lambda: True
        app_main.close_window(instrument)
    return BenchmarkResult(title="A dragged parameter in its column", unit="", rows=tuple(rows), notes=tuple(told))


def _cases(sample: Path, folder: Path) -> Iterator[_Case]:
    both = sample.with_name("digit_gelslim.h5")
    yield _Case(name="GelSlim", session={"recording": sample, "source": "gelslim", "target": "soft_bubble", "frame": 5})
    yield _Case(name="bubble", session={"recording": sample, "source": "soft_bubble", "target": "gelslim", "frame": 5})
    yield _Case(name="DIGIT", session={"recording": both, "source": "digit", "target": "gelslim", "frame": 3})
    yield _Case(name="GelSlim, bubble by T2D2", session={
        "recording": sample, "source": "gelslim", "target": "soft_bubble", "frame": 5, "methods": {"touch": "t2d2"},
    })  # fmt: skip
    large = _enlarged(sample, folder)
    yield _Case(name="GelSlim, 1280 x 1708", session={
        "recording": large, "source": "gelslim", "target": "soft_bubble", "frame": 1, "reference": large / "0.png",
    })  # fmt: skip


def _enlarged(sample: Path, folder: Path) -> Path:
    """A folder with the untouched and a touched picture of the sample, four times as large."""
    import cv2

    from pipeline.recordings import open_recording

    stream = open_recording(sample, sensor="gelslim").stream("gelslim")
    frame = stream.frame(5)
    for name, picture in (("0", frame.reference), ("1", frame.image)):
        assert picture is not None
        large = cv2.resize(picture, _LARGE[::-1], interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / f"{name}.png"), cv2.cvtColor(large, cv2.COLOR_RGB2BGR))
    return folder


def _sliders(instrument: Any, application: Any) -> Iterator[tuple[str, list[float], list[float]]]:
    """(its name, processor's ms, ms by the wall clock) of every slider that this route has."""
    from pipeline.base.params import list_settings

    panel = instrument.window.parameters
    for method in instrument.screen.opened.methods:
        for name, (value, told) in list_settings(instrument.session.get_params(method)).items():
            whole = isinstance(value, int)
            if isinstance(value, (bool, str)) or not math.isfinite(told.high - told.low):
                continue
            if whole and told.high - told.low < _MANY:
                continue
            panel.dragged = method.key
            step = max(1, round(told.step)) if whole else 0.02 * (told.high - told.low)
            step = step if value + MOVES * step <= told.high else -step
            taken = [_moved(instrument, application, method, name, value + (n + 1) * step) for n in range(MOVES)]
            panel.dragged = ""
            panel.drag_ended.emit()
            spin(instrument, application)
            instrument.change("back", params={})
            spin(instrument, application)
            yield f"{method.slot}.{name}", *(list(ms) for ms in zip(*taken[_WARM_UP:], strict=True))


def _moved(instrument: Any, application: Any, method: Any, name: str, value: float) -> tuple[float, float]:
    from pipeline.base.params import replace_value

    old = instrument.screen.shown(method.slot)
    begun_s, begun_cpu_s = time.perf_counter(), time.process_time()
    instrument.choose_params(method.key, replace_value(instrument.session.get_params(method), name, value))
    while instrument.screen.shown(method.slot) is old and time.perf_counter() - begun_s < _LIMIT_S:
        application.processEvents()
        time.sleep(0.0003)
    taken = 1e3 * (time.process_time() - begun_cpu_s), 1e3 * (time.perf_counter() - begun_s)
    spin(instrument, application)
    return taken


def _row(case: str, slider: str, cpu: list[float], wall: list[float], notes: list[str]) -> Measurement:
    notes.append(f"{case}, {slider}: processor {np.median(cpu):.0f} ms, wall clock {np.median(wall):.0f} ms")
    taken = Timing(median_ms=float(np.median(cpu)), p95_ms=float(max(cpu)))
    return build_measurement(
        f"{case}: {slider}", ours=taken, ours_error=math.nan, unit="", bar=Requirement(max_ms=ANSWER_MS)
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
