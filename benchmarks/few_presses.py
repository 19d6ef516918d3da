"""How accurate is a calibration from 4, 8, 16 or all presses of a ball, and does it know? Real
Mini, GelSlim 3, DIGIT.

    python -m benchmarks.few_presses [DATA_FOLDER]

Ten draws of each number. A draw's error is the median over the presses judged, at most sixteen; the
median draw is held to the bar. The Mini's presses of one ball are drawn from; those of the same
ball that are not drawn, and those of the other ball, are judged. Of the one ball of the others,
those not drawn. The size of the DIGIT's ball is not known: its error is half of the range from the
10th to the 90th percentile of the diameters, over their median. "Expected" is the 90th percentile
that the calibration states of itself before anything is judged. A draw is worse than none where its
error exceeds that of the same presses read without a calibration by more than 2 points: errors
scatter by 7 points, so that the median of sixteen has a standard error of 1.25 x 7 / sqrt(16) =
2.2, whichever presses are judged.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import list_numbered_files, picture, recorded_data
from pipeline.calibration.calibration_table import make_built_in
from pipeline.calibration.contact_circles import find_largest_part, fit_sphere
from pipeline.core.values.frames import TactileFrame
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.ball_calibration import calibrate_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth

NEEDS = "recorded data"
_DRAWS = 10
_MINI_MM_PER_PX = 0.0634
_SLIM_MM_PER_PX = 0.07  # not certain; the ball is calibrated and judged with the same
_DIGIT_MM = 6.0  # any size will do
_BARS = {"gelsight_mini": {4: 5.0, 8: 4.0, 16: 3.0}, "gelslim": {4: 4.0, 8: 3.0, 16: 3.0},
         "digit": {4: 8.0, 8: 6.0, 16: 5.0}}  # of the median draw's error, %  # fmt: skip
_JUDGED = 16  # presses of a draw
_NOISE = 2.0  # points of a draw's error


class _Ball:
    """Presses of one ball, and the error of each without a calibration."""

    def __init__(self, name, folder, still, pattern, diameter_mm, pixel_mm):
        self.source = load_sensor(name)
        self.still = picture(folder / still)
        self.diameter_mm = diameter_mm
        self.pictures = [picture(p) for p in list_numbered_files(folder, pattern)]
        self.label = f"{name} {diameter_mm:g} mm"
        built_in = make_built_in(self.source)
        self.plain = replace(built_in, pixel_mm=pixel_mm or built_in.pixel_mm)
        self.knows_size = name != "digit"
        # residual: rms to the sphere, as a press was read last
        self._errors = {}
        self.residual_mm = {}

    def errors(self, indices, look_up):
        """Diameter less the true one, over it; a press without a contact counts as wholly wrong."""
        if look_up.is_built_in and look_up.depth_scale_map is None:
            for i in set(indices) - self._errors.keys():
                self._errors[i] = self._error(i, self.plain)
            return np.array([self._errors[i] for i in indices])
        return np.array([self._error(i, look_up) for i in indices])

    def _error(self, index, look_up):
        frame = TactileFrame(
            sensor=self.source.name, image=self.pictures[index], reference=self.still, index=index
        )
        found = estimate_depth(frame, self.source, look_up, DepthParams())
        diameter, self.residual_mm[index] = fit_sphere(
            found.indentation_mm, find_largest_part(found.contact), self.plain.pixel_mm
        )
        return float(np.nan_to_num(diameter / self.diameter_mm - 1, nan=1.0))

    def judge(self, errors):
        """The error of presses by the errors of their diameters, %."""
        if self.knows_size:
            return float(100 * np.median(np.abs(errors)))
        low, middle, high = np.percentile(1 + errors, (10, 50, 90))
        return float(50 * (high - low) / middle)

    def fit_lookup(self, drawn):
        """The calibration of some of the presses, as `tactoscope calibrate balls` makes it."""
        return calibrate_sensor(
            [self.pictures[i] for i in drawn],
            self.still,
            self.source,
            self.diameter_mm,
            pixel_mm=self.plain.pixel_mm,
        )


def measure(data: str = "") -> BenchmarkResult:
    folder = recorded_data(data)
    small, large = (
        _Ball(
            "gelsight_mini",
            folder / "gsmini_balls",
            "background.png",
            f"ball_{d}mm_*.png",
            float(d),
            _MINI_MM_PER_PX,
        )
        for d in ("6.310", "9.500")
    )
    slim = _Ball(
        "gelslim", folder / "gelslim3_balls", "ref.jpg", "sample_*.jpg", 7.6, _SLIM_MM_PER_PX
    )
    digit = _Ball("digit", folder / "digit_balls", "background.png", "0*.png", _DIGIT_MM, None)
    pairs = ((small, small), (small, large), (large, small), (slim, slim), (digit, digit))
    found = []
    for ball, judged in pairs:
        found += _none(ball, judged)
    for n in (4, 8, 16):
        for ball, judged in pairs:
            found += _of_number(ball, judged, n)
    large.residual_mm.clear()
    found += _of_number(small, large, len(small.pictures))
    residual = build_measurement(
        "rms to the sphere, all presses",
        ours=summarize_times([np.nan]),
        unit="mm",
        ours_error=float(np.nanmedian(list(large.residual_mm.values()))),
        bar=Requirement(max_error=0.03),
    )
    return BenchmarkResult(
        title="Balls measured with a look-up from few presses: the median of ten draws",
        unit="%",
        rows=(*(r for r, _ in found), residual),
        notes=tuple(n for _, n in found if n),
    )


def _label(ball: _Ball, judged: _Ball) -> str:
    return f"{ball.label} -> {judged.label}" if judged is not ball else f"{ball.label}, others"


def _none(ball: _Ball, judged: _Ball) -> Iterator[tuple[object, str]]:
    """(row, note) of no calibration."""
    started = time.perf_counter()
    label = _label(ball, judged)
    without = judged.errors(range(len(judged.pictures)), judged.plain)
    ms = summarize_times([1e3 * (time.perf_counter() - started)])
    yield (
        build_measurement(
            f"diameter, {label}, none",
            ours=ms,
            ours_error=judged.judge(without),
            unit="%",
            bar=Requirement(),
        ),
        f"{label} without calibration: p90 {100 * np.percentile(np.abs(without), 90):.0f} %",
    )


def _of_number(ball: _Ball, judged: _Ball, n: int) -> Iterator[tuple[object, str]]:
    """(row, note) of calibrations from `n` presses: error of the worst, and how many are worse
    than none.
    """
    label = _label(ball, judged)
    everything = range(len(judged.pictures))
    without = judged.errors(everything, judged.plain)
    errors = []
    nones = []
    expected = []
    high = []
    ms = []
    scaled = 0
    kept = 0
    harmed = 0
    for seed in range(_DRAWS if n < len(ball.pictures) else 1):
        drawn = sorted(
            int(i) for i in np.random.default_rng(seed).choice(len(ball.pictures), n, replace=False)
        )
        started = time.perf_counter()
        look_up = ball.fit_lookup(drawn)
        ms.append(1e3 * (time.perf_counter() - started))
        others = [i for i in range(len(judged.pictures)) if judged is not ball or i not in drawn]
        others = [
            others[int(k)] for k in np.linspace(0, len(others) - 1, min(_JUDGED, len(others)))
        ]
        mine = judged.errors(others, look_up)
        errors.append(judged.judge(mine))
        nones.append(judged.judge(without[others]))
        high.append(100 * np.percentile(np.abs(mine), 90))
        expected.append(100 * look_up.expected_error.diameter_p90)
        scaled += look_up.depth_scale_map is not None
        kept += look_up.uses_built_in and look_up.depth_scale_map is None
        harmed += errors[-1] > nones[-1] + _NOISE
    found, expected_p90, p90 = (np.array(values) for values in (errors, expected, high))
    what = f"{label}, {n} presses"
    right = np.mean((p90 <= 2 * expected_p90) & (p90 >= 0.5 * expected_p90))
    note = (
        f"{what}: draws {_listed(found)} % (without {_listed(nones)}); p90 {_listed(p90)} %, "
        "expected "
        f"{_listed(expected_p90)} % (within twice and half: {100 * right:.0f} % of draws); worse "
        "than none in "
        f"{harmed}; depth scaled in {scaled}, unchanged in {kept}"
    )
    bar = Requirement(max_error=_BARS[ball.source.name].get(n, 5.0))
    print(note, file=sys.stderr, flush=True)  # the whole takes minutes
    for row, error, unit, limit, said in (
        (f"diameter, {what}", float(np.median(found)), "%", bar, note),
        (f"draws worse than none, {what}", float(harmed), "draws", Requirement(max_error=0.0), ""),
    ):
        yield (
            build_measurement(
                row, ours=summarize_times(ms), ours_error=error, unit=unit, bar=limit
            ),
            said,
        )


def _listed(values) -> str:
    return " ".join(f"{v:.1f}" for v in values)


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
