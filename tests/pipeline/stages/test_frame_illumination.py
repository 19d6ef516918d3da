"""The illumination of a frame and of its recording: a function of content, cached in memory and
on disk.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core import disk_store
from pipeline.core.progress import SILENT
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.gel import light, rest
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.illumination.parameter_fit import fit_leds
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, estimate_gel_depth
from tests.pipeline.stages.test_surface_refinement import mean_error_mm, touch_another_gelslim

PARAMS = DepthParams()


@pytest.fixture
def fits(tmp_path, monkeypatch):
    """Numbers of touches of the LED fits to recordings, with empty caches."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clear_caches()
    fitted = []

    def count(source, touches, *more):
        if len(touches) > 1:
            fitted.append(len(touches))
        return fit_leds(source, touches, *more)

    monkeypatch.setattr(selection, "fit_leds", count)
    yield fitted
    clear_caches()


def clear_caches():
    """Forget all illuminations, as a new process has."""
    light._recordings.clear()


def read(frame, context_frames=()):
    depth, measured = estimate_gel_depth(
        replace(frame, context_frames=context_frames), load_sensor("gelslim"), None, PARAMS
    )
    return depth.indentation_mm.tobytes(), depth.notes, measured


def test_a_new_process_takes_the_leds_of_a_recording_from_disk(fits):
    frames, *_ = touch_another_gelslim()
    context = tuple(frame.image for frame in frames)
    first = read(frames[0], context)
    clear_caches()
    assert read(frames[0], context) == first
    assert fits == [2]


def test_other_context_frames_are_fitted_again(fits):
    frames, *_ = touch_another_gelslim()
    context = tuple(frame.image for frame in frames)
    other = context[1].copy()
    other[100:110, 100:110] += np.uint8(1)
    for images in (context, (context[0], other)):
        clear_caches()
        read(frames[0], images)
    assert fits == [2, 2]


def test_an_illumination_is_the_same_after_the_disk(tmp_path):
    fitted = Illumination(model="leds", parameters=(1.0, -0.25), from_context=True)

    def load(make):
        return disk_store.load_or_make(Illumination, "a recording", (), make, tmp_path)

    assert load(lambda: fitted) == load(Illumination) == fitted


def test_all_frames_of_a_recording_share_its_leds():
    frames, truths, _ = touch_another_gelslim()
    source = load_sensor("gelslim")
    context = tuple(frame.image for frame in frames)
    results = [
        estimate_gel_depth(replace(frame, context_frames=context), source, None, PARAMS)
        for frame in frames
    ]
    assert all(
        "fitted to 2 touches of the recording" in " ".join(depth.notes) for depth, _ in results
    )
    first, second = (measured for _, measured in results)
    state = rest.describe_rest(
        replace(frames[0], context_frames=context), source, None, PARAMS, SILENT
    )
    touches = [light.find_touch(f.image, f.reference, state, SILENT) for f in frames]
    assert first == second
    assert first.parameters == tuple(
        fit_leds(source, [touch.observe(touch.described[0]) for touch in touches])
    )
    for frame, truth, (depth, _) in zip(frames, truths, results, strict=True):
        described, _ = estimate_gel_depth(
            frame, source, None, PARAMS, illumination=Illumination(model="trusted")
        )
        assert mean_error_mm(depth, truth) < 0.6 * mean_error_mm(described, truth)


def test_one_context_frame_changes_nothing():
    (frame, _), _, _ = touch_another_gelslim()
    assert read(frame)[0] == read(frame, (frame.image,))[0]


@pytest.mark.parametrize("name", ["gelslim", "digit"])
def test_results_do_not_depend_on_what_was_asked_before(name):
    (frame, _), _, _ = touch_another_gelslim(name)
    source = load_sensor(name)
    other = DepthParams(smoothing_px=2.0, sensitivity=1.5)
    requests = {"default": PARAMS, "other": other}
    orders = (list(requests), list(requests)[::-1])
    results = []
    for order in orders:
        clear_caches()
        results.append(
            {
                key: estimate_depth(frame, source, None, requests[key]).indentation_mm.tobytes()
                for key in order
            }
        )
    assert results[0] == results[1]
    for key, params in requests.items():
        clear_caches()
        assert (
            estimate_depth(frame, source, None, params).indentation_mm.tobytes() == results[0][key]
        )
