"""Colour limits fitted to a recording: one range for its touches and what is generated from them,
whatever frame is on screen.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.core.errors import TouchError
from pipeline.core.params import list_settings
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, TargetDepth
from pipeline.translation.frame_selection import find_contact_frame
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams

_FITTED = "depth", "target_depth"  # stages whose values the limits hold
_PERCENTILE = 99.5  # of the pixels: single ones may lie beyond
_STEPS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)  # of a decade


def fit_display(
    opened: Translation,
    display: DisplayParams,
    progress: Progress = SILENT,
    strongest: int | None = None,
) -> DisplayParams:
    """Return display parameters whose limits are all set: those that were 0 are fitted to the
    strongest touch of the recording, for each kind of sensor.

    `strongest` is the frame of that touch where it is known. The usual limits stay for a recording
    without a touch, or that grows; a touch that cannot be read leaves them unset.
    """
    sensors = {s.sensor_kind.display_group: s for s in (opened.source, opened.target)}
    usual = {
        f"{group}_limit_mm": display.get_limit_mm(sensor)
        for group, sensor in sensors.items()
        if not getattr(display, f"{group}_limit_mm")
    }
    if not usual:
        return display
    peaks: dict[str, float] = {}
    if opened.recording.refresh is None:
        index = find_contact_frame(opened.stream) if strongest is None else strongest
        try:
            for group, peak_mm in _measure_peaks(opened, index, progress):
                name = f"{group}_limit_mm"
                peaks[name] = max(peak_mm, peaks.get(name, 0.0))
        except TouchError:  # which the frame on screen says; fitted once it can be read
            return display
    fitted = {
        name: min(round_up(peaks[name]), list_settings(display)[name][1].high)
        if peaks.get(name)
        else limit_mm
        for name, limit_mm in usual.items()
    }
    return replace(display, **fitted)


def _measure_peaks(
    opened: Translation, index: int, progress: Progress
) -> Iterator[tuple[str, float]]:
    """Yield the kind of sensor and how far its surface moves in a frame, mm."""
    source = opened.source.sensor_kind.display_group
    target = opened.target.sensor_kind.display_group
    frame = opened.stream.frame(index)
    observed = opened.read_target_observation(index)
    stages = [name for name in opened.stages if name in _FITTED]
    results = opened.evaluate(frame, stages, progress)
    yield source, _measure_frame(frame)
    if observed is not None:
        yield target, _measure_frame(observed[0])
    for name, group in zip(_FITTED, (source, target), strict=True):
        value = results[name].output if name in results else None
        if isinstance(value, DepthMap | TargetDepth):
            yield group, _find_peak(value.indentation_mm[value.contact])


def _measure_frame(frame: TactileFrame) -> float:
    """Return how far a recorded membrane is from its reference; 0 for a colour image."""
    reference = frame.reference
    if not frame.is_depth or reference is None or reference.shape != frame.image.shape:
        return 0.0
    return _find_peak(np.asarray(reference, np.float32) - frame.image)


def _find_peak(values_mm: Any) -> float:
    known = np.abs(values_mm[np.isfinite(values_mm)])
    return float(np.percentile(known, _PERCENTILE)) if known.size else 0.0


def round_up(peak_mm: float) -> float:
    """Return the next round number that a peak does not exceed."""
    decade = 10.0 ** math.floor(math.log10(peak_mm))
    step = next(step for step in _STEPS if step * decade >= peak_mm * (1.0 - 1e-9))
    return round(step * decade, 6)
