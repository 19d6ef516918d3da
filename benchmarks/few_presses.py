"""How good is a look-up from four, eight, sixteen or all presses of a ball, and does it know? Real Mini and GelSlim 3.

    python benchmarks/few_presses.py [DATA_FOLDER]

Ten draws of each number. A draw's error is the median over the presses judged; the worst draw is held to the bar. The
Mini's presses of 6.310 mm are drawn from and those of 9.500 mm are judged; of the GelSlim's one ball, those not drawn.
"Expected" is what the calibration says of itself before anything is judged. The last notes show that presses of one
ball fit any width of a pixel alike: the share of the slopes that is left over does not change with it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.ball_calibration import numbered, read, sphere
from benchmarks.races import Bar, row, timing
from benchmarks.recorded import recorded_data
from pipeline.calibration.lookup import built_in
from pipeline.racing.races import Answer
from pipeline.racing.report import show
from pipeline.sensors.spec import sensor
from pipeline.stages.depth.ball_calibration import calibrated
from pipeline.stages.depth.stage import DepthParams, depth
from pipeline.values.frames import TactileFrame

NEEDS = "recorded data"
_DRAWS = 10
_MINI_MM_PER_PX = 0.0634
_SLIM_MM_PER_PX = 0.07  # not certain; the ball is calibrated and judged with the same
_BARS = {4: 12.0, 8: 10.0, 16: 8.0}  # of the worst draw's error, %
_FEWEST_PX = 20


def answer(data: str = "") -> Answer:
    folder = recorded_data(data)
    found = [*_minis(folder / "gsmini_balls"), *_slims(folder / "gelslim3_balls")]
    return Answer(
        title="Balls measured with a look-up from few presses: the worst of ten draws",
        unit="%",
        rows=tuple(r for r, _ in found),
        notes=(*(n for _, n in found), *_widths(folder)),
    )


def _widths(folder: Path) -> Iterator[str]:
    """What is left of the slopes of eight presses, calibrated with other widths of a pixel."""
    for name, place, still_name, pattern, diameter_mm, pixel_mm in (
        ("gelsight_mini", "gsmini_balls", "background.png", "ball_6.310mm_*.png", 6.31, _MINI_MM_PER_PX),
        ("gelslim", "gelslim3_balls", "ref.jpg", "sample_*.jpg", 7.6, _SLIM_MM_PER_PX),
    ):
        still, pictures = read(folder / place / still_name), [read(p) for p in numbered(folder / place, pattern)][:8]
        told = []
        for width in (0.67 * pixel_mm, pixel_mm, 1.5 * pixel_mm):
            look_up = calibrated(pictures, still, sensor(name), diameter_mm, pixel_mm=width)
            steep = np.array([p.radius_px for p in look_up.presses if p.used]) * width / (0.5 * diameter_mm)
            rms = 0.5 * 0.85 * float(np.sqrt(np.mean(steep**2)))  # of one axis, over the trusted disc
            told.append(
                f"{width:.4f} mm: {look_up.residual:.3f} mm/mm, {100 * look_up.residual / rms:.0f} % of the slopes"
            )
        yield f"{name}, eight presses, left over at a pixel of " + "; ".join(told)


def _minis(folder: Path) -> Iterator[tuple[object, str]]:
    source, still = sensor("gelsight_mini"), read(folder / "background.png")
    small, large = ([read(p) for p in numbered(folder, f"ball_{d}mm_*.png")] for d in ("6.310", "9.500"))
    yield _none(source, still, large, 9.5, "Mini 9.500 mm")
    for n in (4, 8, 16, len(small)):
        yield _drawn(source, still, small, n, (6.31, 9.5), _MINI_MM_PER_PX, large, "Mini 6.310 -> 9.500 mm")


def _slims(folder: Path) -> Iterator[tuple[object, str]]:
    source, still = sensor("gelslim"), read(folder / "ref.jpg")
    pictures = [read(p) for p in numbered(folder, "sample_*.jpg")]
    for n in (4, 8, 16):
        yield _drawn(source, still, pictures, n, (7.6, 7.6), _SLIM_MM_PER_PX, None, "GelSlim 3 7.6 mm, others")


def _drawn(source, still, pictures, n, diameters_mm, pixel_mm, judged, label):
    """(row, note) of look-ups from `n` of the pictures."""
    errors, expected, ms, kept = [], [], [], 0
    for seed in range(_DRAWS if n < len(pictures) else 1):
        drawn = {int(i) for i in np.random.default_rng(seed).choice(len(pictures), n, replace=False)}
        started = time.perf_counter()
        look_up = calibrated([pictures[i] for i in sorted(drawn)], still, source, diameters_mm[0], pixel_mm=pixel_mm)
        ms.append(1e3 * (time.perf_counter() - started))
        others = judged if judged is not None else [p for i, p in enumerate(pictures) if i not in drawn]
        errors.append(_errors(source, still, look_up, others, diameters_mm[1]))
        expected.append(100 * look_up.expected.diameter_share)
        kept += look_up.kept_built_in
    worst = np.array([100 * np.median(np.abs(e)) for e in errors])
    high = np.array([100 * np.percentile(np.abs(e), 90) for e in errors])
    bar = Bar(error=_BARS[n]) if n in _BARS else Bar(error=5.0)
    what = f"{label}, {n} presses"
    told = np.mean((worst <= 2 * np.array(expected)) & (worst >= 0.5 * np.array(expected)))
    note = (
        f"{what}: draws {_listed(worst)} %; expected {_listed(expected)} % (within twice and half: {100 * told:.0f} % "
        f"of draws); p90 of a draw {np.median(high):.0f} %, at most {high.max():.0f} %; built-in kept in {kept}"
    )
    return row(f"diameter, {what}", ours=timing(ms), ours_error=float(worst.max()), unit="%", bar=bar), note


def _none(source, still, judged, diameter_mm, label):
    """(row, note) of the built-in look-up."""
    started = time.perf_counter()
    errors = _errors(source, still, built_in(source), judged, diameter_mm)
    ms = [1e3 * (time.perf_counter() - started)]
    note = f"{label} without calibration: p90 {100 * np.percentile(np.abs(errors), 90):.0f} %"
    error = float(100 * np.median(np.abs(errors)))
    return row(f"diameter, {label}, none", ours=timing(ms), ours_error=error, unit="%", bar=Bar()), note


def _errors(source, still, look_up, pictures, diameter_mm):
    """Diameter less the true one, over it, of every picture; one without a contact counts as wholly wrong."""
    errors = []
    for index, picture in enumerate(pictures):
        frame = TactileFrame(sensor=source.name, image=picture, reference=still, index=index)
        found = depth(frame, source, look_up, DepthParams())
        if found.contact.sum() < _FEWEST_PX:
            errors.append(1.0)
            continue
        errors.append(sphere(found.indentation_mm, found.contact, look_up.pixel_mm)[0] / diameter_mm - 1)
    return np.array(errors)


def _listed(values) -> str:
    return " ".join(f"{v:.1f}" for v in values)


if __name__ == "__main__":
    show(answer(*sys.argv[1:2]))
