"""Is a real gel at rest outside its contact? Largest depth farther than some distances from it, over many presses.

Run: python benchmarks/outside_contact.py DATA, with the folder of real recordings; the DIGIT presses in it are used.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

from pipeline import routes
from pipeline.translate import Request, new_graph, open_translation

DISTANCES_MM = (0.5, 1.0, 1.25, 2.0, 3.0)


def main():
    folder = Path(sys.argv[1]) / "digit_balls"
    translation = open_translation(Request(recording=folder, source="digit", target="gelslim"))
    graph, params = new_graph(), routes.default_params()
    largest, n_touched = [], 0
    for index in range(translation.n_frames):
        depth = graph.evaluate(["depth"], translation.inputs(index), params)["depth"].output
        n_touched += bool(depth.contact.any())
        away_mm = ndimage.distance_transform_edt(~depth.contact) * translation.source.pixel_mm
        largest.append([depth.indentation_mm[away_mm > d].max(initial=0.0) for d in DISTANCES_MM])
    print(f"contact in {n_touched} of {translation.n_frames} frames")
    print(f"{'farther than mm':>16s} {'largest mm':>11s} {'median mm':>11s}")
    for k, distance in enumerate(DISTANCES_MM):
        column = np.array(largest)[:, k]
        print(f"{distance:16.2f} {column.max():11.3f} {np.median(column):11.3f}")


if __name__ == "__main__":
    main()
