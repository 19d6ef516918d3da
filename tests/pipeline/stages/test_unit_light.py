from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.sensors.spec import load_sensor
from pipeline.simulation import variation
from pipeline.stages.depth import led_calibration, recording_led_calibration
from pipeline.stages.depth.photometric import DepthParams, estimate_gel_depth
from tests.pipeline.stages.test_gel_light import on_another_gelslim

PARAMS = DepthParams()


@pytest.fixture
def fits(tmp_path, monkeypatch):
    """How often lamps are fitted to several touches, in a cache of the test's own; `again` is a new process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    recording_led_calibration._cache.clear()
    asked, fit = [], led_calibration.fit_leds

    def counted(source, touches, *more):
        if len(touches) > 1:
            asked.append(len(touches))
        return fit(source, touches, *more)

    monkeypatch.setattr(led_calibration, "fit_leds", counted)
    yield asked
    recording_led_calibration._cache.clear()


def read(frame, beside):
    found, measured = estimate_gel_depth(replace(frame, context_frames=beside), load_sensor("gelslim"), None, PARAMS)
    return found.indentation_mm.tobytes(), found.notes, measured.light


def test_a_new_process_reads_a_recording_by_the_lamps_that_an_earlier_one_has_fitted(fits):
    frames, *_ = on_another_gelslim()
    beside = tuple(frame.image for frame in frames)
    first = read(frames[0], beside)
    recording_led_calibration._cache.clear()
    assert read(frames[0], beside) == first
    assert fits == [2]


def test_other_touches_are_fitted_anew(fits):
    frames, *_ = on_another_gelslim()
    beside = tuple(frame.image for frame in frames)
    other = beside[1].copy()
    other[100:110, 100:110] += np.uint8(1)
    for touches in (beside, (beside[0], other)):
        recording_led_calibration._cache.clear()
        read(frames[0], touches)
    assert fits == [2, 2]


def test_lamps_come_back_from_a_file_as_they_were():
    described = load_sensor("gelslim").optics
    other = variation.vary_sensor(load_sensor("gelslim"), 7).optics
    kept = recording_led_calibration._StoredOptics.from_optics(
        replace(other, base_rgb=described.base_rgb, glows=described.glows)
    )
    back = kept.to_optics(described)
    assert (back.leds, back.falloff, back.blur_px, back.shadow) == (
        other.leds, other.falloff, other.blur_px, other.shadow,
    )  # fmt: skip
    assert recording_led_calibration._StoredOptics.from_optics(None).to_optics(described) is None
