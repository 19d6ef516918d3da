"""How exact and how fast is a gel's contact? Ours against geometric overlap and a pyramid of blurs,
against Hertz.

    python -m benchmarks.gel_contact

A ball of 4 mm radius reaches 0.5 mm into a half-space 18.6 mm wide, 320 x 427 pixels; Hertz gives
surface, contact and force exactly. The pyramid is our own writing of the published recipe: the
overlap is blurred six times with Gaussian kernels of 201, 101, 51, 21, 11 and 5 pixels (of a 480 x
640 image, scaled to this one) and put back after each where the overlap is more than 0.4 of its
depth. Baselines answer for no force.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from benchmarks.harness.results import BenchmarkResult, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from pipeline.physics import gel
from pipeline.sensors.parts import Gel

_OURS = "ours, half-space"
_LAYER = "ours, 2 mm bonded layer"
_SHAPE = (320, 427)
_WIDTH_MM = 18.6
_RADIUS_MM = 4.0
_DEPTH_MM = 0.5
_HALF_SPACE = Gel(thickness_mm=math.inf, youngs_kpa=120.0, poisson=0.48)
_PAD = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)
_PIXEL_MM = _WIDTH_MM / _SHAPE[1]


def measure() -> BenchmarkResult:
    r = _radius_mm()
    overlap = (_DEPTH_MM - r * r / (2 * _RADIUS_MM)).astype(np.float32)
    exact, touching = _hertz(r, overlap)
    methods = {
        _OURS: lambda: _ours(_HALF_SPACE, overlap),
        "geometric overlap": lambda: (np.maximum(overlap, 0), overlap > 0),
        "pyramid of blurs": lambda: _pyramid(overlap),
        _LAYER: lambda: _ours(_PAD, overlap),
    }
    errors = {}
    notes = [_against_hertz(overlap)]
    for name, run in methods.items():
        if name != _LAYER:  # which has no closed form
            surface, contact = run()
            errors[name] = 1e3 * float(np.sqrt(np.mean((surface - exact) ** 2)))
            iou = (contact & touching).sum() / (contact | touching).sum()
            notes.append(
                f"{name}: mask IoU {iou:.3f}, largest error "
                f"{1e3 * np.abs(surface - exact).max():.3g} um"
            )
    times = time_in_turns(methods, runs=25)
    rows = [
        build_measurement(
            "surface of a pressed half-space",
            peer=peer,
            ours=times[_OURS],
            ours_error=errors[_OURS],
            unit="um",
            peer_timing=times[peer],
            peer_error=errors[peer],
            bar=Requirement(max_ms=20, min_error_ratio=100),
        )
        for peer in ("geometric overlap", "pyramid of blurs")
    ]
    rows.append(
        build_measurement(
            "surface of a bonded layer of 2 mm",
            ours=times[_LAYER],
            ours_error=math.nan,
            unit="um",
            bar=Requirement(max_ms=20),
        )
    )
    return BenchmarkResult(
        title=f"Contact of a ball with a gel, {_SHAPE[0]} x {_SHAPE[1]} pixels, against Hertz",
        unit="um",
        rows=tuple(rows),
        points=tuple(
            PlotPoint(method=name, ms=times[name].median_ms, error=error, ours=name == _OURS)
            for name, error in errors.items()
        ),
        notes=tuple(notes),
    )


def _against_hertz(overlap) -> str:
    pressed = gel.press_gel(_HALF_SPACE, _PIXEL_MM, overlap)
    radius = math.sqrt(pressed.contact.sum() / math.pi) * _PIXEL_MM
    return (
        f"ours: contact radius {100 * (radius / math.sqrt(_RADIUS_MM * _DEPTH_MM) - 1):+.2f} %, "
        f"force {100 * (pressed.force_n / _hertz_force_n() - 1):+.4f} %, {pressed.steps} steps, "
        f"residual {1e3 * pressed.residual_mm:.3f} um"
    )


def _radius_mm():
    y, x = np.mgrid[: _SHAPE[0], : _SHAPE[1]]
    return np.hypot(y - (_SHAPE[0] - 1) / 2, x - (_SHAPE[1] - 1) / 2) * _PIXEL_MM


def _hertz(r, overlap):
    """(indentation, contact) of the half-space, exactly."""
    a = math.sqrt(_RADIUS_MM * _DEPTH_MM)
    far = np.maximum(r, a * (1 + 1e-12))
    free = ((2 * a * a - far * far) * np.arcsin(a / far) + a * np.sqrt(far * far - a * a)) / (
        math.pi * _RADIUS_MM
    )
    return np.where(r < a, overlap, free), r < a


def _hertz_force_n() -> float:
    effective_kpa = _HALF_SPACE.youngs_kpa / (1 - _HALF_SPACE.poisson**2)
    return 4 / 3 * effective_kpa * 1e-3 * math.sqrt(_RADIUS_MM) * _DEPTH_MM**1.5


def _ours(pad: Gel, overlap):
    pressed = gel.press_gel(pad, _PIXEL_MM, overlap)
    return pressed.indentation_mm, pressed.contact


def _pyramid(overlap):
    """Overlap, blurred coarse to fine, put back on the presumed contact after every blur but the
    last, finest one.
    """
    held = np.maximum(overlap, 0)
    contact = overlap > 0.4 * held.max()
    surface = held
    for size in (201, 101, 51, 21, 11, 5):
        width = 2 * round(size * _SHAPE[1] / 640 / 2) + 1
        surface = cv2.GaussianBlur(surface, (width, width), 0)
        surface = np.where(contact, held, surface)
    return cv2.GaussianBlur(surface, (5, 5), 0), contact


if __name__ == "__main__":
    print_result(measure())
