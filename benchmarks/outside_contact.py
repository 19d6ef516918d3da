"""Is a real gel at rest outside its contact? Largest depth farther than some distances from it, over many presses.

Run: python benchmarks/outside_contact.py [DATA], with the folder of real recordings; the DIGIT presses in it are used.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.data_folder import recorded_data
from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.translation.catalogue import default_params
from pipeline.translation.translate import Request, open_translation

NEEDS = "recorded data"
DISTANCES_MM = (0.5, 1.0, 1.25, 2.0, 3.0)


def measure(data: str = "") -> BenchmarkResult:
    folder = recorded_data(data) / "digit_balls"
    translation = open_translation(Request(recording=folder, source="digit", target="gelslim"))
    graph, params = translation.build_graph(), default_params(translation.methods)
    largest, taken, n_touched = [], [], 0
    for index in range(translation.n_frames):
        result = graph.evaluate(["depth"], translation.read_inputs(index), params)["depth"]
        depth = result.output
        taken.append(result.ms)
        n_touched += bool(depth.contact.any())
        away_mm = ndimage.distance_transform_edt(~depth.contact) * translation.source.pixel_mm
        largest.append([depth.indentation_mm[away_mm > d].max(initial=0.0) for d in DISTANCES_MM])
    most = np.array(largest).max(axis=0)
    rows = tuple(
        build_measurement(f"largest depth beyond {distance:g} mm of the contact", ours=summarize_times(taken), ours_error=float(mm), unit="mm",
            bar=Requirement(max_error=0.03))
        for distance, mm in zip(DISTANCES_MM, most, strict=True)
    )  # fmt: skip
    return BenchmarkResult(title="A real DIGIT at rest outside its contact", unit="mm", rows=rows,
                  notes=(f"contact in {n_touched} of {translation.n_frames} frames",))  # fmt: skip


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
