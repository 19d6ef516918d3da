"""How accurate is an uncalibrated sensor? Balls on a real GelSight Mini, GelSlim 3.0 and DIGIT.

Clips of a GelSlim 4.0.

    python -m benchmarks.real_depth [METHOD [DATA_FOLDER]]

METHOD is a method of the stage *depth* (default by sensor) and knows nothing of the sensor instance
but its reference image. A sphere is fitted to the surface inside the largest part of the contact:
the error of its diameter is the median over all presses of |diameter / true - 1|, a press without a
contact of 20 pixels counting as 100 %; the residual is the median of the fits' rms. A patch is
stray when it is any part of the contact but the largest. GelSlim 3.0's width of a pixel is not
certain: once it is given (0.07 mm, about what its images fit best), once fitted, one width for all
presses that makes the median diameter of a third of them right, so that only the scatter of
diameters is left. Nobody knows the size of DIGIT's balls.

In the clips, a frame is reported right when a contact is found where the lab's own network sees one
and none where it sees none: more than half a percent of its image darker by 25 grey than the
median. Every second frame is looked at. The correlation is Pearson's between the indentation and
the lab's depth over the panel, median over the frames with contact. The reference is once the first
frame, once the median of the first frames that show the same, as when a recording is opened. Panels
are enlarged to the sensor's own pixels first. The lab's depth is a baseline, not truth.

It lies in another frame than its image (`benchmarks/panel_registration.py`), so the correlation
stands once more with the lab's depth laid on the touch first: by one transform for all clips,
fitted to the edges in two of them and scored on the other two, and the other way round. Each two
are of both fingers and of both things. Next to it, as the baseline, how much the lab's own depth,
so laid, is like itself as it was: an exact depth would score about that in the row above.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes import panel_registration
from benchmarks.scenes.depth_helpers import (
    DepthReader,
    at_scale,
    build_reader,
    list_numbered_files,
    patches,
    picture,
    recorded_data,
)
from pipeline.calibration.contact_circles import find_largest_part, fit_sphere
from pipeline.core.values.frames import TactileFrame
from pipeline.io.reference_images import denoise_reference
from pipeline.sensors.spec import load_sensor

NEEDS = "recorded data"
_GELSLIM3_MM_PER_PX = 0.07
# every third press tells the width
_FITTING_TURNS = 3
_FITTED_TO = 3
# of the lab's depth: a contact
_DARKER_GREY = 25
_DARK_SHARE = 0.005
_EVERY = 2  # frame of a clip
_CLIPS = ("finray_left", "finray_right", "hex_key_left", "hex_key_right")
_HALVES = (("finray_left", "hex_key_right"), ("finray_right", "hex_key_left"))


@dataclass(frozen=True, slots=True, kw_only=True)
class PressResult:
    """A frame of a clip."""

    touched: bool  # as the lab sees it
    found: bool
    ours: np.ndarray  # indentation in mm on the lab's panel
    deep: np.ndarray  # the lab's, in grey
    ms: float


def balls(read: DepthReader, files, still, source):
    """Of every press: diameter in mm, rms in mm, number of patches, time in ms."""
    found = []
    for index, file in enumerate(files):
        frame = TactileFrame(sensor=source.name, image=picture(file), reference=still, index=index)
        started = time.perf_counter()
        answer = read(frame, source)
        ms = 1e3 * (time.perf_counter() - started)
        diameter, rms = fit_sphere(
            answer.indentation_mm, find_largest_part(answer.contact), source.pixel_mm
        )
        found.append((diameter, rms, len(patches(answer.contact)), ms))
    return np.array(found).T


def build_rows(label, found, diameter_mm, bars):
    """Rows of diameter, residual and patches, and a note, of `balls`."""
    diameter, rms, n, ms = found
    error = np.nan_to_num(100 * np.abs(diameter / diameter_mm - 1), nan=100.0)
    values = (
        ("diameter", float(np.median(error)), "%", bars[0]),
        ("residual", float(np.nanmedian(rms)), "mm", bars[1]),
        ("presses with stray patches", float((n > 1).sum()), "presses", bars[2]),
    )
    rows = [
        build_measurement(
            f"{label}: {what}", ours=summarize_times(ms), ours_error=value, unit=unit, bar=bar
        )
        for what, value, unit, bar in values
    ]
    bias = 100 * (np.nanmedian(diameter) / diameter_mm - 1)
    note = (
        f"{label}: contact in {(n > 0).sum():g} of {len(n)}; diameter bias {bias:+.1f} %, "
        f"p90 {np.percentile(error, 90):.1f} %; rms p90 {np.nanpercentile(rms, 90):.4f} mm"
    )
    return rows, note


def minis(read: DepthReader, data: Path):
    folder = data / "gsmini_balls"
    mini = load_sensor("gelsight_mini")
    still = picture(folder / "background.png")
    for diameter_mm, name in ((9.5, "9.500"), (6.31, "6.310")):
        files = list_numbered_files(folder, f"ball_{name}mm_*.png")
        bars = (Requirement(max_error=10), Requirement(max_error=0.03), Requirement(max_error=2))
        yield build_rows(
            f"Mini, {diameter_mm:g} mm", balls(read, files, still, mini), diameter_mm, bars
        )


def gelslims(read: DepthReader, data: Path):
    folder = data / "gelslim3_balls"
    plain = load_sensor("gelslim")
    still = picture(folder / "ref.jpg")
    files = list_numbered_files(folder, "sample_*.jpg")
    bars = (Requirement(max_error=12), Requirement(), Requirement(max_error=2))
    width = _GELSLIM3_MM_PER_PX
    found = balls(read, files, still, at_scale(plain, width))
    yield build_rows(f"GelSlim 3, 7.6 mm, {width:g} mm/px given", found, 7.6, bars)
    for _ in range(_FITTING_TURNS):
        width *= 7.6 / np.nanmedian(found[0])
        found = balls(read, files[::_FITTED_TO], still, at_scale(plain, width))
    found = balls(read, files, still, at_scale(plain, width))
    yield build_rows(f"GelSlim 3, 7.6 mm, {width:.4f} mm/px fitted", found, 7.6, bars)


def digits(read: DepthReader, data: Path):
    folder = data / "digit_balls"
    digit = load_sensor("digit")
    still = picture(folder / "background.png")
    files = list_numbered_files(folder, "0*.png")
    diameter, rms, n, ms = balls(read, files, still, digit)
    values = (
        ("presses without contact", float((n == 0).sum()), "presses", Requirement(max_error=0)),
        ("residual", float(np.nanmedian(rms)), "mm", Requirement(max_error=0.02)),
        ("presses with stray patches", float((n > 1).sum()), "presses", Requirement()),
    )
    rows = [
        build_measurement(
            f"DIGIT balls: {what}", ours=summarize_times(ms), ours_error=value, unit=unit, bar=bar
        )
        for what, value, unit, bar in values
    ]
    low, middle, high = np.nanpercentile(diameter, (10, 50, 90))
    yield (
        rows,
        f"DIGIT balls: diameters {low:.1f} to {high:.1f} mm (p10, p90), median {middle:.1f} mm",
    )


def clip(read: DepthReader, folder: Path, *, steady: bool):
    """What was read of every second frame after the first, and the clip's edges."""
    source = load_sensor("gelslim")
    rows, cols = source.camera.shape

    def enlarge(image):
        return cv2.resize(image, (cols, rows), interpolation=cv2.INTER_CUBIC)

    pictures = [picture(file) for file in list_numbered_files(folder, "touch_*.png")]
    depths = [_deep(file) for file in list_numbered_files(folder, "lab_depth_*.png")]
    still = enlarge(pictures[0])
    found = []
    if steady:
        still, _ = denoise_reference(still, (enlarge(image) for image in pictures[1:]))
    for index in range(1, len(pictures), _EVERY):
        frame = TactileFrame(
            sensor=source.name, image=enlarge(pictures[index]), reference=still, index=index
        )
        started = time.perf_counter()
        answer = read(frame, source)
        ms = 1e3 * (time.perf_counter() - started)
        deep = depths[index]
        ours = cv2.resize(answer.indentation_mm, deep.shape[::-1], interpolation=cv2.INTER_AREA)
        found.append(
            PressResult(
                touched=_touched(deep),
                found=bool(answer.contact.any()),
                ours=ours,
                deep=deep,
                ms=ms,
            )
        )
    with_contact = [index for index in range(1, len(pictures)) if _touched(depths[index])]
    of_contact = ([images[index] for index in with_contact] for images in (pictures, depths))
    return found, panel_registration.edges(*of_contact, still=pictures[0].astype(np.float32))


def _deep(file: Path) -> np.ndarray:
    lab = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE).astype(np.float32)
    return float(np.median(lab)) - lab


def _touched(deep: np.ndarray) -> bool:
    return bool((deep > _DARKER_GREY).mean() > _DARK_SHARE)


def clips(read: DepthReader, data: Path):
    for steady, label in ((False, "first frame"), (True, "median of first frames")):
        looked = {}
        edges = {}
        notes = []
        for name in _CLIPS:
            looked[name], edges[name] = clip(read, data / "gelslim4_clips" / name, steady=steady)
            right, alike = right_and_alike(looked[name])
            notes.append(
                f"{name}: {len(looked[name])} frames, named right {right:.2f}, correlation "
                f"{alike:.2f}"
            )
        every = [frame for name in _CLIPS for frame in looked[name]]
        right, alike = right_and_alike(every)
        ms = summarize_times([frame.ms for frame in every])
        ours, itself, laid_notes = compare_registered_depth(looked, edges)
        lab = {"peer": "the lab's own, as it was", "peer_error": 1 - itself}
        values = (
            ("frames named wrong", 1 - right, "share", Requirement(max_error=0.07), {}),
            (
                "1 - correlation with the lab's depth",
                1 - alike,
                "",
                Requirement(max_error=0.25),
                {},
            ),
            (
                "1 - correlation, the lab's depth laid on the touch first",
                1 - ours,
                "",
                Requirement(),
                lab,
            ),
        )
        rows = [
            build_measurement(
                f"GelSlim 4 clips, {label}: {what}",
                ours=ms,
                ours_error=value,
                unit=unit,
                bar=bar,
                **peer,
            )
            for what, value, unit, bar, peer in values
        ]
        yield (
            rows,
            f"{label}: " + "; ".join(notes) + "; laid on the touch: " + "; ".join(laid_notes),
        )


def right_and_alike(found: list[PressResult]) -> tuple[float, float]:
    right = float(np.mean([frame.touched == frame.found for frame in found]))
    return right, float(
        np.median(
            [
                panel_registration.correlate(frame.ours, frame.deep)
                for frame in found
                if frame.touched
            ]
        )
    )


def compare_registered_depth(looked, edges):
    """Median correlations with the lab's depth laid on the touch, of our depth and of the lab's
    as it was; notes.
    """
    every = []
    notes = []
    for fitted_on, scored_on in (_HALVES, _HALVES[::-1]):
        lay = panel_registration.fit_panel_map([edges[name] for name in fitted_on])
        for name in scored_on:
            pairs = []
            for frame in (frame for frame in looked[name] if frame.touched):
                there, known = lay.warp(frame.deep)
                pairs.append(
                    [
                        panel_registration.correlate(one, there, known)
                        for one in (frame.ours, frame.deep)
                    ]
                )
            ours, itself = np.median(pairs, axis=0)
            every += pairs
            notes.append(
                f"{name} {ours:.2f}, the lab's own {itself:.2f} (x{lay.scale_x:.2f} "
                f"x{lay.scale_y:.2f}, "
                f"{lay.shift_x_px:+.1f} {lay.shift_y_px:+.1f} px of {known.shape[1]})"
            )
    ours, itself = np.median(every, axis=0)
    return float(ours), float(itself), notes


def measure(method: str = "", data: str = "") -> BenchmarkResult:
    folder = recorded_data(data)
    read = build_reader(method)
    found = [
        *minis(read, folder),
        *gelslims(read, folder),
        *digits(read, folder),
        *clips(read, folder),
    ]
    return BenchmarkResult(
        title=f"Depth of real, uncalibrated units by {method}",
        unit="%",
        rows=tuple(row for rows, _ in found for row in rows),
        notes=tuple(note for _, note in found),
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:3]))
