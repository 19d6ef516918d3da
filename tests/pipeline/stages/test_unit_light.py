from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.sensors.spec import sensor
from pipeline.simulation import variation
from pipeline.stages.depth import own_lamps, unit_light
from pipeline.stages.depth.stage import DepthParams, gel
from tests.pipeline.stages.test_gel_light import on_another_gelslim

PARAMS = DepthParams()


@pytest.fixture
def fits(tmp_path, monkeypatch):
    """How often lamps are fitted to several touches, in a cache of the test's own; `again` is a new process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    unit_light._kept.clear()
    asked, fit = [], own_lamps.fitted

    def counted(source, touches, *more):
        if len(touches) > 1:
            asked.append(len(touches))
        return fit(source, touches, *more)

    monkeypatch.setattr(own_lamps, "fitted", counted)
    yield asked
    unit_light._kept.clear()


def read(frame, beside):
    found, measured = gel(replace(frame, beside=beside), sensor("gelslim"), None, PARAMS)
    return found.indentation_mm.tobytes(), found.notes, measured.light


def test_a_new_process_reads_a_recording_by_the_lamps_that_an_earlier_one_has_fitted(fits):
    frames, *_ = on_another_gelslim()
    beside = tuple(frame.image for frame in frames)
    first = read(frames[0], beside)
    unit_light._kept.clear()
    assert read(frames[0], beside) == first
    assert fits == [2]


def test_other_touches_are_fitted_anew(fits):
    frames, *_ = on_another_gelslim()
    beside = tuple(frame.image for frame in frames)
    other = beside[1].copy()
    other[100:110, 100:110] += np.uint8(1)
    for touches in (beside, (beside[0], other)):
        unit_light._kept.clear()
        read(frames[0], touches)
    assert fits == [2, 2]


def test_lamps_come_back_from_a_file_as_they_were():
    described = sensor("gelslim").optics
    other = variation.varied(sensor("gelslim"), 7).optics
    kept = unit_light._Fitted.of(replace(other, base_rgb=described.base_rgb, glows=described.glows))
    back = kept.beside(described)
    assert (back.leds, back.falloff, back.blur_px, back.shadow) == (
        other.leds, other.falloff, other.blur_px, other.shadow,
    )  # fmt: skip
    assert unit_light._Fitted.of(None).beside(described) is None
