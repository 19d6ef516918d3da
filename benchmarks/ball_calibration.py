"""How accurate is a calibration from presses of one ball on others? Real GelSight Mini, DIGIT and GelSlim 3.0 images.

    python benchmarks/ball_calibration.py [DATA_FOLDER]

"Diameter" is that of the sphere nearest to the depth inside the contact found by the stage, "rms" the distance to it.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.data_folder import recorded_data
from benchmarks.scenes.depth_helpers import list_numbered_files, picture
from pipeline.calibration.sphere_fit import fit_sphere
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.ball_calibration import calibrate_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

NEEDS = "recorded data"
_MINI_MM_PER_PX = 0.0634
_NO_BARS = (Requirement(), Requirement())
_BESIDE_MM = 3.0  # farther from the contact than this the gel is called far


def measure_presses(label, pictures, still, source, look_up, diameter_mm, bars=_NO_BARS):
    """(row of the diameter's error, row of the rms, note) of presses measured with a calibration table."""
    fits, far, ms = [], [], []
    for index, image in enumerate(pictures):
        frame = TactileFrame(sensor=source.name, image=image, reference=still, index=index)
        started = time.perf_counter()
        result = estimate_depth(frame, source, look_up, DepthParams())
        ms.append(1e3 * (time.perf_counter() - started))
        away = cv2.distanceTransform((~result.contact).astype(np.uint8), cv2.DIST_L2, 5) * look_up.pixel_mm
        far.append(float(np.abs(result.indentation_mm[away > _BESIDE_MM]).max(initial=0.0)))
        d, rms = fit_sphere(result.indentation_mm, result.contact, look_up.pixel_mm)
        fits.append((d / diameter_mm - 1, rms))
    fits = np.array(fits)
    missing = int(np.isnan(fits[:, 0]).sum())
    error, rms = fits[np.isfinite(fits[:, 0])].T
    rows = tuple(
        build_measurement(f"{what}, {label}", ours=summarize_times(ms), ours_error=float(value), unit=unit, bar=bar)
        for what, value, unit, bar in (
            ("diameter", 100 * np.median(np.abs(error)), "%", bars[0]),
            ("rms to the sphere", np.median(rms), "mm", bars[1]),
        )
    )
    note = (
        f"{label}: {len(pictures)} presses, {missing} missed; diameter bias {100 * np.median(error):+.1f} %, "
        f"p90 {100 * np.percentile(np.abs(error), 90):.1f} %; rms p90 {np.percentile(rms, 90):.4f} mm; "
        f"largest depth beyond {_BESIDE_MM:g} mm {max(far):.3f} mm"
    )
    return rows, note


def measure(data: str = "") -> BenchmarkResult:
    folder = recorded_data(data)
    found = [*measure_mini(folder / "gsmini_balls"), *measure_other_sensors(folder)]
    return BenchmarkResult(
        title="Balls measured with a look-up from other presses",
        unit="%",
        rows=tuple(row for rows, _ in found for row in rows),
        notes=tuple(note for _, note in found),
    )


def measure_mini(folder: Path):
    mini, still = load_sensor("gelsight_mini"), picture(folder / "background.png")
    small, large = ([picture(p) for p in list_numbered_files(folder, f"ball_{d}mm_*.png")] for d in ("6.310", "9.500"))
    whole = calibrate_sensor(small, still, mini, 6.31, pixel_mm=_MINI_MM_PER_PX)
    label = f"Mini {len(small)} of 6.310 mm -> {len(large)} of 9.500 mm"
    yield measure_presses(
        label, large, still, mini, whole, 9.5, (Requirement(max_error=10), Requirement(max_error=0.03))
    )
    for k in (0, 1):
        half = calibrate_sensor(small[k::2], still, mini, 6.31, pixel_mm=_MINI_MM_PER_PX)
        yield measure_presses(f"Mini half of 6.310 mm -> other half ({k})", small[1 - k :: 2], still, mini, half, 6.31)


def measure_other_sensors(data: Path):
    for name, folder_name, reference, pattern, sizes in (
        ("digit", "digit_balls", "background.png", "0*.png", ((5.0, None), (6.0, None), (8.0, None))),
        ("gelslim", "gelslim3_balls", "ref.jpg", "sample_*.jpg", ((7.6, 0.05), (7.6, 0.07), (7.6, 0.10577))),
    ):
        source, folder = load_sensor(name), data / folder_name
        still = picture(folder / reference)
        pictures = [picture(p) for p in list_numbered_files(folder, pattern)]
        for diameter_mm, pixel_mm in sizes:
            half = calibrate_sensor(pictures[::2], still, source, diameter_mm, pixel_mm=pixel_mm)
            label = f"{name} {diameter_mm:g} mm at {half.pixel_mm:.4f} mm/px, half -> half"
            yield measure_presses(label, pictures[1::2], still, source, half, diameter_mm)


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
