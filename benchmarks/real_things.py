"""Is the contact of everyday objects on a real GelSight Mini in one piece, without specks?

    python -m benchmarks.real_things [METHOD [DATA_FOLDER]]

METHOD is a method of the stage *depth* (default by sensor) and knows nothing of the sensor instance
but its reference image. There is no truth: counted is what the eye would complain of. A *crumb* is
a part of the contact smaller than a thousandth of the image; a *corner blob* a part that lies whole
in a corner of an eighth of the image's sides; a *stair* a run of 8 straight pixels or more in the
contact's outline, along a row or a column and inside the image: the share of the outline in such
runs, less that which an exact circle of the same area has. Times are of an image.
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import (
    build_reader,
    list_numbered_files,
    patches,
    picture,
    recorded_data,
)
from pipeline.core.values.frames import TactileFrame
from pipeline.sensors.spec import load_sensor

NEEDS = "recorded data"
_CRUMB = 1e-3
_CORNER = 8
_STAIR_PX = 8
# grains are small, a handle is straight
_OWN_LOOK = {"rice": ("crumbs", "corner blobs"), "toothbrush": ("stairs",)}


def corner_blobs(contact) -> int:
    rows, cols = contact.shape
    n = 0
    for x, y, wide, high, _ in cv2.connectedComponentsWithStats(
        contact.astype(np.uint8), connectivity=8
    )[2][1:]:
        at_side = x + wide <= cols // _CORNER or x >= cols - cols // _CORNER
        n += at_side and (y + high <= rows // _CORNER or y >= rows - rows // _CORNER)
    return n


def straight(contact) -> float:
    """Share of the outline's pixels that lie in straight runs along a row or a column."""
    inner = np.zeros_like(contact)
    inner[1:-1, 1:-1] = True
    found = total = 0
    for turned in (contact, contact.T):
        inside = inner if turned is contact else inner.T
        edge = (turned[1:] != turned[:-1]) & inside[1:] & inside[:-1]
        total += int(edge.sum())
        for line in edge:
            ends = np.flatnonzero(np.diff(np.concatenate(([0], line.view(np.int8), [0]))))
            runs = ends[1::2] - ends[::2]
            found += int(runs[runs >= _STAIR_PX].sum())
    return found / total if total else 0.0


def circle_of(n_px: int) -> float:
    """What an exact circle of this area has of straight runs."""
    r = np.sqrt(n_px / np.pi)
    y, x = np.mgrid[-int(r) - 3 : int(r) + 4, -int(r) - 3 : int(r) + 4]
    return straight(x**2 + y**2 <= r**2)


def measure(method: str = "", data: str = "") -> BenchmarkResult:
    folder = recorded_data(data) / "mini_things"
    read = build_reader(method)
    mini = load_sensor("gelsight_mini")
    rows = []
    for thing in sorted(path for path in folder.iterdir() if path.is_dir()):
        still = picture(thing / "ref.jpg")
        taken = []
        crumbs = 0
        blobs = 0
        stairs = []
        pieces = []
        for index, file in enumerate(list_numbered_files(thing, "frame_*.jpg")):
            frame = TactileFrame(
                sensor=mini.name, image=picture(file), reference=still, index=index
            )
            started = time.perf_counter()
            found = read(frame, mini)
            taken.append(1e3 * (time.perf_counter() - started))
            areas = np.array(patches(found.contact), dtype=int)
            crumbs += int((areas < _CRUMB * found.contact.size).sum())
            blobs += corner_blobs(found.contact)
            pieces.append(len(areas))
            if found.contact.any():
                stairs.append(straight(found.contact) - circle_of(int(areas[0])))
        label = f"{thing.name} ({', '.join(map(str, pieces))} parts)"
        figures = (
            ("crumbs", crumbs, "parts", Requirement(max_error=0)),
            ("corner blobs", blobs, "parts", Requirement(max_error=0)),
            (
                "stairs",
                float(np.mean(stairs)) if stairs else 0.0,
                "share",
                Requirement(max_error=0.1),
            ),
        )
        own = _OWN_LOOK.get(thing.name.split("_")[0], ())
        for what, value, unit, bar in figures:
            kept = Requirement() if what in own else bar
            rows.append(
                build_measurement(
                    f"{label}: {what}",
                    ours=summarize_times(taken),
                    ours_error=value,
                    unit=unit,
                    bar=kept,
                )
            )
    return BenchmarkResult(
        title=f"Contact of everyday things on a Mini, by {method}", unit="", rows=tuple(rows)
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:3]))
