"""How well is a bubble's touch read off its noisy depth image? What presses on the membrane, beside its curvature.

    python benchmarks/bubble_reading.py

Tools that nothing was tuned on are pressed on simulated bubbles, a little (apex pushed in by about 4 mm) and a lot
(13 mm), and seen by a time-of-flight camera, a stereo camera and a camera without noise. The peer is this project's
reading before: a median, a smoothing spline, and a limit on the spline's curvature. Contacts on a bubble are mostly
edges two or three pixels wide, so that one pixel of widening costs half of the overlap. An error of contact is
1 - intersection over union with the pixels where the pressure is positive; one of depth is the mean absolute
difference, within the contact and beside it.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, Timing, build_measurement, time_in_turns
from pipeline.base.arrays import freeze
from pipeline.metrics.stage_metrics import iou, mean_abs_mm
from pipeline.physics import bubble_camera
from pipeline.racing.results import BenchmarkResult, PlotPoint
from pipeline.racing.text_report import print_result
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import poses, shapes
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import simulate_press
from pipeline.stages.depth import contact
from pipeline.stages.depth.bubble_contact import denoise_displacement
from pipeline.stages.depth.bubble_depth import fill_gaps
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

_FLIGHT, _STEREO = load_sensor("soft_bubble"), load_sensor("soft_bubble_stereo")
_GRASPS = (1, 7)  # of each tool's grid
_SHARE, _CURVATURE_MM, _SPLINE_MM, _SPECK_MM2 = 0.35, 1.5, 1.25, 20.0  # of the reading before
_CASES = {
    "time of flight": (
        Requirement(min_error_ratio=1.1, max_ms=50),
        Requirement(min_error_ratio=1.4),
        Requirement(min_error_ratio=1.4, max_error=0.15),
    ),
    "stereo": (
        Requirement(min_error_ratio=1.05, max_ms=50),
        Requirement(min_error_ratio=1.0),
        Requirement(min_error_ratio=1.6, max_error=0.15),
    ),
    "no noise": (
        Requirement(min_error_ratio=1.25, max_ms=50),
        Requirement(min_error_ratio=8, max_error=0.05),
        Requirement(max_error=0.02),
    ),
}
_WHAT = (("contact", "1 - IoU"), ("depth in contact", "mm"), ("depth outside", "mm"))
_PEER = "spline and curvature"


def measure() -> BenchmarkResult:
    presses = [p for deeper_mm in (0.0, BUBBLE_DEEPER_MM) for p in _presses(deeper_mm)]
    rows, points = [], []
    for k, (case, bars) in enumerate(_CASES.items()):
        seen = [(_image(case, image, 100 + i), truth) for i, (image, truth) in enumerate(presses)]
        errors = {name: _errors(read, seen) for name, read in _METHODS.items()}
        times = time_in_turns(
            {name: lambda read=read, image=seen[0][0]: read(image) for name, read in _METHODS.items()}
        )
        rows += [
            build_measurement(f"{what}, {case}", ours=times["ours"], peer=_PEER, peer_timing=times[_PEER], unit=unit, bar=bar,
                ours_error=errors["ours"][i], peer_error=errors[_PEER][i])
            for i, ((what, unit), bar) in enumerate(zip(_WHAT, bars, strict=True))
        ]  # fmt: skip
        points += [_point(name, case, times[name], errors[name][0]) for name in _METHODS] if k == 0 else []
    return BenchmarkResult(
        title="Contact of a bubble seen by a time-of-flight camera", unit="1 - IoU", rows=tuple(rows),
        points=tuple(points), notes=(f"{len(presses)} presses of {', '.join(shapes.list_shapes('unseen'))}",),
    )  # fmt: skip


def _presses(deeper_mm: float):
    """(exact depth image, truth) of every press."""
    felt_by = _standing_out(deeper_mm)
    for k, name in enumerate(shapes.list_shapes("unseen")):
        thing = shapes.make_shape(name).mesh
        grid = poses.make_paper_grid(thing, n=12, seed=50 + k)
        for j in _GRASPS:
            pressed = simulate_press(thing, grid[j], felt_by, seed=None)
            yield np.asarray(pressed.image, np.float64), pressed.truth


def _standing_out(deeper_mm: float):
    """The bubble, standing farther out toward the object."""
    pose = np.array(_FLIGHT.alignment_from_sensor)
    pose[2, 3] += deeper_mm
    return replace(_FLIGHT, alignment_from_sensor=freeze(pose))


def _image(case: str, depth_mm, seed: int):
    camera = _STEREO if case == "stereo" else _FLIGHT
    return bubble_camera.simulate_depth_frame(camera, depth_mm, None if case == "no noise" else seed)


def _errors(read, seen) -> tuple[float, float, float]:
    """Means of (1 - IoU, depth in contact, depth outside)."""
    found = []
    for image, truth in seen:
        moved, touched = read(image)
        found.append((1 - iou(touched, truth.contact), mean_abs_mm(moved, truth.indentation_mm, truth.contact),
                      mean_abs_mm(moved, truth.indentation_mm, ~truth.contact)))  # fmt: skip
    errors = np.mean(found, axis=0)
    return float(errors[0]), float(errors[1]), float(errors[2])


def _ours(image):
    frame = TactileFrame(sensor=_FLIGHT.name, image=image, reference=_FLIGHT.rest_depth_mm.astype(np.float32))
    found = estimate_depth(frame, _FLIGHT, None, DepthParams())
    return found.indentation_mm, found.contact


def _before(image):
    moved = _FLIGHT.rest_depth_mm.astype(np.float32) - image
    seen = np.isfinite(moved)
    moved, _ = fill_gaps(np.where(seen, moved, np.float32(0.0)), seen)
    moved = denoise_displacement(moved, _SPLINE_MM / _FLIGHT.pixel_mm)
    pressed = contact.detect_membrane_contact(moved, least_mm=_FLIGHT.limits.contact_min_mm, pressure_share=_SHARE,
                                       smoothing_px=_CURVATURE_MM / _FLIGHT.pixel_mm)  # fmt: skip
    return moved, contact.remove_specks(pressed, round(_SPECK_MM2 / _FLIGHT.pixel_mm**2))


_METHODS = {"ours": _ours, _PEER: _before}


def _point(name: str, case: str, timing: Timing, error: float) -> PlotPoint:
    return PlotPoint(method=f"{name}, {case}", ms=timing.median_ms, error=error, ours=name == "ours")


if __name__ == "__main__":
    print_result(measure())
