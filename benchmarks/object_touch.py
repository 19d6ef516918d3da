"""How accurate is the touch by the registered object, and does it know? Random solids, against the
physical render.

    python -m benchmarks.object_touch

Every touch is of another closed solid that is in no catalogue, at a pose of the paper's grid, with
the sensor's noise. Errors are means over the true contact of the target; the physical render sees
what the source measured alone. Coverage is the share of pixels in contact whose true indentation
lies within the stated 90 % interval; its error is the distance from 90 %. Times are CPU time of a
frame whose object is prepared, without the source's depth.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.random_solids import make_random_solid
from pipeline.core.graph import Fallback
from pipeline.core.progress import SILENT
from pipeline.lab.tasks.touches import Moment, place_sensor
from pipeline.physics.simulation import poses
from pipeline.stages.touch.object_touch import ObjectParams
from pipeline.stages.touch.stage import OBJECT

_N_TOUCHES = 24
_FIRST_SEED = 100
# source, target -> largest share of the physical render's error, over the image and in contact
_BARS = {
    ("gelslim", "soft_bubble"): (0.35, 0.30),
    ("digit", "soft_bubble"): (0.55, 0.40),
    ("digit", "gelslim"): (0.75, 0.70),
    ("soft_bubble", "gelslim"): (0.7, 0.8),
}
_MAX_MS = 400.0
_QUANTILE = 1.645
_COVERED = 90.0
_TOLERANCE = 5.0
_STD_FROM_MEAN = np.sqrt(np.pi / 2.0)


def measure() -> BenchmarkResult:
    rows = []
    notes = []
    for (source, target), (everywhere, in_contact) in _BARS.items():
        ours, theirs, covered, times_ms, n_refused = _score(source, target)
        timing = summarize_times(times_ms)
        pair = f"{source} to {target}"
        for k, (region, bar) in enumerate(
            (("over the image", everywhere), ("in contact", in_contact))
        ):
            rows.append(
                build_measurement(
                    f"{pair}, {region}",
                    peer="physical render",
                    ours=timing,
                    ours_error=float(ours[:, k].mean()),
                    unit="mm",
                    peer_error=float(theirs[:, k].mean()),
                    bar=Requirement(max_ms=_MAX_MS, min_error_ratio=1.0 / bar),
                )
            )
        rows.append(
            build_measurement(
                f"{pair}, coverage",
                ours=timing,
                ours_error=abs(100.0 * float(np.mean(covered)) - _COVERED),
                unit="%",
                bar=Requirement(max_error=_TOLERANCE),
            )
        )
        notes.append(
            f"{pair}: coverage {np.mean(covered):.0%}, better on "
            f"{np.mean(ours[:, 0] < theirs[:, 0]):.0%}, "
            f"{n_refused} of {len(ours)} refused"
        )
    return BenchmarkResult(
        title="Touch by the object", unit="mm", rows=tuple(rows), notes=tuple(notes)
    )


def _score(source: str, target: str):
    """(errors, errors of the physical render, coverage, times in ms, refused meshes) of every
    touch.
    """
    ours = []
    theirs = []
    covered = []
    times_ms = []
    n_refused = 0
    seed = _FIRST_SEED
    while len(ours) < _N_TOUCHES:
        seed += 1
        mesh = make_random_solid(seed)
        rng = np.random.default_rng(seed)
        pose = poses.make_paper_grid(mesh, n=4, seed=seed)[seed % 4]
        places = [place_sensor(name, rng, 0.0) for name in (source, target)]
        frames = [place.record(mesh, pose, index=0, time_s=0.0) for place in places]
        if any(truth is None or not truth.contact.any() for _, truth in frames):
            continue
        moment = Moment(mesh, frames, places[0].nominal, places[1].nominal)
        translation, results = moment.evaluate("physics", "touch")
        inputs = {
            **translation.read_inputs(0),
            **{name: one.output for name, one in results.items()},
        }
        reads = [inputs[name] for name in OBJECT.reads]
        OBJECT.run(*reads, ObjectParams(), SILENT)  # prepares the object
        started = time.process_time()
        touch = OBJECT.run(*reads, ObjectParams(), SILENT)
        times_ms.append(1e3 * (time.process_time() - started))
        n_refused += isinstance(touch, Fallback)
        touch = touch.result if isinstance(touch, Fallback) else touch
        membrane = getattr(touch, "output", touch).membrane
        truth = frames[1][1]
        off_mm = np.abs(membrane.indentation_mm - truth.indentation_mm)
        by_physics = np.abs(results["touch"].output.membrane.indentation_mm - truth.indentation_mm)
        ours.append((off_mm.mean(), off_mm[truth.contact].mean()))
        theirs.append((by_physics.mean(), by_physics[truth.contact].mean()))
        if membrane.expected_error_mm is not None:
            limit_mm = _QUANTILE * _STD_FROM_MEAN * membrane.expected_error_mm
            covered.append((off_mm <= limit_mm)[truth.contact].mean())
    return np.array(ours), np.array(theirs), covered, times_ms, n_refused


if __name__ == "__main__":
    print_result(measure())
