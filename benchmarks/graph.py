"""What does a frame cost that needs no work: one seen before, one without contact?

    python -m benchmarks.graph [RECORDING] [TARGET]

Baseline: a touched frame through all stages with an empty cache. Every frame is a new object, as
read from a camera; sensors, mesh and reference are known, as in a stream. Errors count the stages
whose output or course is not as it must be: equal to a run with an empty cache, and nothing but the
pose recomputed when a setting of the pose changes.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times, time_in_turns
from pipeline.core.graph import Graph
from pipeline.translation.catalogue import BUILT_IN, default_params
from pipeline.translation.translate import Request, open_translation

_SAMPLE = Path(__file__).resolve().parents[1] / "sample_data" / "recordings" / "first_touch.h5"
_PEER = "all stages of a touched frame"
_METHODS = BUILT_IN.methods("t2d2", kinds={"source": "gel", "target": "bubble"})
_PARAMS = default_params(_METHODS)
_STAGES = tuple(method.stage for method in _METHODS)
_RUNS = 41


def measure(path: Path = _SAMPLE, target: str = "soft_bubble") -> BenchmarkResult:
    translation = open_translation(Request(recording=path, target=target))
    touched, untouched = first_frames(translation)
    graph = Graph(_METHODS)
    fresh = Graph(_METHODS)
    seen = graph.evaluate(_STAGES, touched, _PARAMS)
    still = graph.evaluate(_STAGES, untouched, _PARAMS)
    again = copies(touched, vary=False)
    new = copies(untouched, vary=True)

    def first_of_all():
        fresh.cache.clear()
        return fresh.evaluate(_STAGES, next(new), _PARAMS)

    raced = {
        "frame seen before": (
            lambda: graph.evaluate(_STAGES, next(again), _PARAMS),
            seen,
            Requirement(max_ms=0.2, max_error=0),
        ),
        "new untouched frame of a stream": (
            lambda: graph.evaluate(_STAGES, next(new), _PARAMS),
            still,
            Requirement(max_ms=0.5, max_error=0),
        ),
        "first untouched frame, empty cache": (
            first_of_all,
            still,
            Requirement(max_ms=0.5, max_error=0),
        ),
    }
    errors = {name: differing(run(), wanted) for name, (run, wanted, _) in raced.items()}
    times = time_in_turns({name: run for name, (run, _, _) in raced.items()}, runs=_RUNS)
    peer = time_in_turns(
        {_PEER: lambda: Graph(_METHODS).evaluate(_STAGES, touched, _PARAMS)}, runs=7
    )[_PEER]
    rows = [
        build_measurement(
            name,
            peer=_PEER,
            ours=times[name],
            peer_timing=peer,
            ours_error=errors[name],
            unit="stages",
            bar=bar,
        )
        for name, (_, _, bar) in raced.items()
    ]
    return BenchmarkResult(
        title=f"A frame that needs no work, {translation.source.name} to {target}",
        unit="stages",
        rows=(*rows, pose_setting_changed(graph, touched, peer)),
    )


def first_frames(translation):
    """Inputs of the first frame that touches and of the first that does not."""
    graph = Graph(_METHODS)
    found = {}
    for index in range(translation.n_frames):
        inputs = translation.read_inputs(index)
        contact = graph.evaluate(["depth"], inputs, _PARAMS)["depth"].output.contact.any()
        found.setdefault(bool(contact), inputs)
        if len(found) == 2:
            return found[True], found[False]
    raise SystemExit("the recording needs a touched and an untouched frame")


def copies(inputs, *, vary: bool):
    """The inputs with the frame's image copied, and with `vary` never the same twice, without
    end.
    """
    frame = inputs["frame"]
    pictures = [frame.image.copy() for _ in range(8)]
    for count in itertools.count():
        picture = pictures[count % len(pictures)]
        if vary:
            picture.reshape(-1)[:2] = np.divmod(count, 256)
        yield {**inputs, "frame": dataclasses.replace(frame, image=picture)}


def differing(results, wanted) -> float:
    return float(sum(results[name].digest != wanted[name].digest for name in wanted))


def pose_setting_changed(graph, touched, peer):
    """The row of a changed seed of the pose: all other stages must come from the cache."""
    taken = []
    wrong = 0
    for seed in range(101, 108):
        changed = {**_PARAMS, "pose": dataclasses.replace(_PARAMS["pose"], seed=seed)}
        results = graph.evaluate(_STAGES, touched, changed)
        taken.append(sum(r.ms for r in results.values()))
        wrong = max(
            wrong, sum((r.state == "computed") != (name == "pose") for name, r in results.items())
        )
    return build_measurement(
        "a setting of the pose changed",
        peer=_PEER,
        ours=summarize_times(taken),
        peer_timing=peer,
        ours_error=float(wrong),
        unit="stages",
        bar=Requirement(max_error=0),
    )


if __name__ == "__main__":
    given = sys.argv[1:]
    print_result(measure(*([Path(given[0])] if given else []), *given[1:2]))
