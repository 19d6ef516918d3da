"""A frame of an open recording passes few modules on its way from pixels to pose."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pipeline
from pipeline.translation.translate import Request, open_translation

PACKAGE = str(Path(pipeline.__file__).parent)
SAMPLE = Path(__file__).parents[3] / "sample_data/recordings/first_touch.h5"


@contextmanager
def count_modules() -> Iterator[tuple[set[str], list[str]]]:
    """Modules of the package in which a function is called, and the module of every step, calls
    and returns.
    """
    modules = set[str]()
    steps = [""]
    callers = [""]

    def follow(frame, event, _argument):
        if event == "call":
            file = frame.f_code.co_filename
            callers.append(file if file.startswith(PACKAGE) else callers[-1])
            modules.update(callers[-1:])
        elif event == "return" and len(callers) > 1:
            callers.pop()
        if callers[-1] != steps[-1]:
            steps.append(callers[-1])

    before = sys.getprofile()
    sys.setprofile(follow)
    try:
        yield modules, steps
    finally:
        sys.setprofile(before)
        modules.discard("")


def test_a_frame_passes_few_modules():
    request = Request(recording=SAMPLE, source="gelslim", target="soft_bubble", route="t2d2")
    with open_translation(request) as translation:
        translation.evaluate(4)
        with count_modules() as (modules, steps):
            results = translation.evaluate(5)
    assert {result.state for result in results.values()} == {"computed"}
    assert 50 < len(modules) <= 97
    assert len(steps) < 3700
