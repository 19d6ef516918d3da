"""How exact is a gel's depth with its light modelled? The look-up corrected by the optics beside the look-up alone.

    python benchmarks/gel_depth.py

Training and unseen objects are pressed on the simulated DIGIT, in every other press on a unit whose lights, shadows and
gel differ from what the depth is told. Errors are mean absolute errors of the depth in the contact, over presses of one
depth. GelSlim and GelSight Mini cast no shadows that are described: there it is the lens blur that is modelled.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.calibration.calibration_table import make_built_in
from pipeline.geometry import rigid
from pipeline.physics import optics
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

_DEPTHS_MM = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
_OTHERS_MM = 0.5
_UNITS = (1, 2, 3)
_GOAL = Requirement(max_ms=15, min_error_ratio=1.0, max_error=0.05)  # of a DIGIT; the others must not get worse
_PARAMS = DepthParams()


def objects() -> tuple[str, ...]:
    return (*shapes.list_shapes("training")[::2], *shapes.list_shapes("unseen"))


def presses(name: str, depth_mm: float):
    """Frames and truths of every object at one depth."""
    rng = np.random.default_rng(round(100 * depth_mm))
    for index, thing in enumerate(shapes.make_shape(n).mesh for n in objects()):
        told = load_sensor(name)
        unit = told if index % 2 == 0 else vary_sensor(told, _UNITS[index // 2 % len(_UNITS)])
        pose = rigid.translation(*rng.uniform(-3.0, 3.0, 2), 0.0) @ rigid.rotation((0, 0, rng.uniform(-0.7, 0.7)))
        pose[2, 3] = -depth_mm - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
        felt = simulate_press(thing, pose, unit, seed=index)
        if felt.converged and felt.truth.contact.any():
            yield TactileFrame(sensor=name, image=felt.image, reference=optics.render_reference(unit)), felt.truth


def compare_lookups(name: str, depth_mm: float):
    """(errors, times, IoUs, biases, errors outside) of ours and of the look-up alone, press by press."""
    told = load_sensor(name)
    plain = replace(told, optics=None)  # describes no light: the look-up alone is used
    look_up = make_built_in(told)
    found = {"ours": [], "plain": []}
    for frame, truth in presses(name, depth_mm):
        inside = truth.contact
        for way, source in (("ours", told), ("plain", plain)):
            estimate_depth(frame, source, look_up, _PARAMS)
            started = time.perf_counter()
            answer = estimate_depth(frame, source, look_up, _PARAMS)
            taken = 1e3 * (time.perf_counter() - started)
            off = answer.indentation_mm - truth.indentation_mm
            iou = (answer.contact & inside).sum() / (answer.contact | inside).sum()
            found[way].append((np.abs(off[inside]).mean(), taken, iou, off[inside].mean(), np.abs(off[~inside]).mean()))
    return tuple(np.array(found[way]).T for way in ("ours", "plain"))


def measure() -> BenchmarkResult:
    rows, notes = [], []
    for name, depths in (("digit", _DEPTHS_MM), ("gelslim", (_OTHERS_MM,)), ("gelsight_mini", (_OTHERS_MM,))):
        for depth_mm in depths:
            ours, plain = compare_lookups(name, depth_mm)
            bar = _GOAL if name == "digit" else Requirement(min_error_ratio=1.0)
            rows.append(build_measurement(
                f"{name}, pressed by {depth_mm:g} mm", peer="look-up alone", ours=summarize_times(ours[1]),
                peer_timing=summarize_times(plain[1]), ours_error=float(ours[0].mean()), peer_error=float(plain[0].mean()),
                unit="mm", bar=bar,
            ))  # fmt: skip
            told = " and ".join(
                f"IoU {iou.mean():.3f}, bias {bias.mean():+.3f}, outside {outside.mean():.3f} mm"
                for _, _, iou, bias, outside in (ours, plain)
            )
            notes.append(f"{name} {depth_mm:g} mm: {told} (look-up alone)")
    return BenchmarkResult(title="Depth in the contact of a gel", unit="mm", rows=tuple(rows), notes=tuple(notes))


if __name__ == "__main__":
    print_result(measure())
