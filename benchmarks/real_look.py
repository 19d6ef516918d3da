"""How near are simulated pictures to real ones? Presses of a ball on a real GelSight Mini, DIGIT and GelSlim 3.0.

    python benchmarks/real_look.py [DATA_FOLDER [SHEET.png]]

Every press is simulated again on its own untouched picture: the circle of contact is the calibration's, the depth that
which gives the circle's area on the layer of the sensor (gel.press), the colours those of the built-in optics. Errors
are in grey levels (of 255) over the contact, all three colours. The peer is to change nothing: how much the real
colours change there. Times are of one picture.
SHEET.png shows the first few presses of each sensor: real, simulated.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.data_folder import recorded_data
from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.calibration.balls import calibrate_balls
from pipeline.geometry.camera import Camera
from pipeline.physics import gel, optics
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.sensors.spec import load_sensor

NEEDS = "recorded data"
_MAX_PRESSES = 24  # of each sensor
_SHOWN = 5
_SENSORS = (  # sensor, folder, untouched, presses, ball in mm, mm per pixel (None = the sensor's)
    ("gelsight_mini", "gsmini_balls", "background.png", "ball_6.310mm_*.png", 6.31, 0.0634),
    ("digit", "digit_balls", "background.png", "0*.png", 6.0, None),
    ("gelslim", "gelslim3_balls", "ref.jpg", "sample_*.jpg", 7.6, 0.07),
)


def read(path: Path):
    return np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])


def list_numbered_files(folder: Path, pattern: str) -> list[Path]:
    return sorted(folder.glob(pattern), key=lambda p: int("".join(c for c in p.stem.split("_")[-1] if c.isdigit())))


def at_scale(source, pixel_mm):
    """The sensor with pixels of this width, as its unit has them."""
    c = source.camera
    focal = float(np.median(source.rest_depth_mm)) / pixel_mm
    camera = Camera(rows=c.rows, cols=c.cols, fx_px=focal, fy_px=focal, cx_px=c.cx_px, cy_px=c.cy_px)
    return dataclasses.replace(source, camera=camera)


def press_ball(source, pixel_mm, fit, radius_mm):
    """(surface, depth) of the ball pressed until its contact has the area of the circle found."""
    y, x = np.mgrid[: source.camera.rows, : source.camera.cols]
    r_sq = ((x - fit.x_px) ** 2 + (y - fit.y_px) ** 2) * pixel_mm**2
    cap = np.where(r_sq < radius_mm**2, np.sqrt(np.maximum(radius_mm**2 - r_sq, 0.0)) - radius_mm, -9.0)
    wanted = np.pi * fit.radius_px**2
    low, high = 0.0, 0.9 * radius_mm
    for _ in range(9):
        depth = 0.5 * (low + high)
        answer = gel.press_gel(source.gel, pixel_mm, depth + cap, tolerance_mm=1e-3)
        low, high = (depth, high) if answer.contact.sum() < wanted else (low, depth)
    return answer.indentation_mm, depth


def on_reference(source, still, surface):
    """The built-in optics' change of colour on the real untouched picture."""
    plain = dataclasses.replace(source, markers=None)
    change = optics.render(plain, surface, seed=None).astype(np.float32) - optics.render_reference(plain)
    return np.clip(still + change, 0, 255)


def measure_sensor(name, data, folder_name, reference, pattern, diameter_mm, scale):
    """(row, note, some presses real and simulated) of one sensor."""
    source, folder = load_sensor(name), data / folder_name
    if scale is not None:
        source = at_scale(source, scale)
    still = read(folder / reference)
    pictures = [read(p) for p in list_numbered_files(folder, pattern)][:_MAX_PRESSES]
    pixel_mm = source.pixel_mm
    everything = calibrate_balls(pictures, still, source, diameter_mm, pixel_mm=pixel_mm)
    errors, biases, taken, changes, depths, shown = [], [], [], [], [], []
    for fit in (fit for fit in everything.presses if fit.used):
        surface, depth = press_ball(source, pixel_mm, fit, diameter_mm / 2)
        real = pictures[fit.index].astype(np.float32)
        started = time.perf_counter()
        made = on_reference(source, still, surface)
        taken.append(1e3 * (time.perf_counter() - started))
        y, x = np.mgrid[: real.shape[0], : real.shape[1]]
        inside = np.hypot(x - fit.x_px, y - fit.y_px) < fit.radius_px
        depths.append(depth)
        changes.append(rms((real - still)[inside]))
        off = (made - real)[inside]
        errors.append(rms(off))
        biases.append(float(off.mean()))
        if len(shown) < _SHOWN:
            shown.append(np.vstack([real, made]).astype(np.uint8))
    found = build_measurement(
        f"{name}, built-in optics", peer="no change at all", ours=summarize_times(taken), ours_error=float(np.median(errors)),
        peer_error=float(np.median(changes)), unit="grey", bar=Requirement(),
    )  # fmt: skip
    told = f"median depth {np.median(depths):.2f} mm; simulated less real: {np.median(biases):+.1f}"
    return found, f"{name}: {len(depths)} presses, {told}", shown


def rms(off) -> float:
    return float(np.sqrt(np.mean(off**2)))


def measure(data: str = "", sheet: str = "") -> BenchmarkResult:
    folder = recorded_data(data)
    found = [measure_sensor(name, folder, *how) for name, *how in _SENSORS]
    if sheet:
        save_sheet([picture for _, _, shown in found for picture in shown], sheet)
    return BenchmarkResult(
        title="Simulated presses of a ball beside real ones, colour error in the contact",
        unit="grey",
        rows=tuple(row for row, _, _ in found),
        notes=tuple(note for _, note, _ in found),
    )


def save_sheet(columns, sheet: str) -> None:
    tall = [cv2.resize(c, (round(c.shape[1] * 720 / c.shape[0]), 720), interpolation=cv2.INTER_AREA) for c in columns]
    cv2.imwrite(sheet, np.hstack(tall)[..., ::-1])


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:3]))
