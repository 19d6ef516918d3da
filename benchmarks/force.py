"""How accurate is force after two weighings? The contact model against volume and area times depth, three sensors.

    python -m benchmarks.force

A ball is weighed twice on each of four other sensor instances (`varied`, strength 1), at a quarter of the range of
depths and at its end; then tools that nothing was chosen by are pressed at random depths, places and turns, on many of
which the contact leaves the view. Depth is by network. Every method gets the same scale from the same weighings; the
error is the median of |force / true force - 1| over presses of 0.3 N and more, Spearman's order is that over all
instances.
"""

from __future__ import annotations

import time

import numpy as np
from scipy import stats

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import build_reader
from pipeline.base.entry_points import load_reference
from pipeline.calibration.force_scale import fit_force_scale
from pipeline.geometry import rigid
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.values.frames import TactileFrame

_RANGES = {"gelslim": (0.2, 0.8, 2.5), "digit": (0.2, 0.8, 2.5), "soft_bubble": (-1.0, 8.0, 15.0)}  # depths, place, mm
_INSTANCES, _TOOLS, _LEAST_N = 4, 16, 0.3


def estimate_all(sensor, indentation_mm, contact):
    """Forces by the contact model, by volume, and by area times mean depth, up to a factor."""
    contact = contact & np.isfinite(indentation_mm)
    inside, pushed = indentation_mm[contact].sum(dtype=float), np.nansum(np.maximum(indentation_mm, 0.0), dtype=float)
    return load_reference(sensor.sensor_kind.force_estimator)(sensor, indentation_mm, contact), pushed, inside


def press_instance(read, name: str, number: int):
    """(estimates (n, 3), true forces (n,), ms) of one instance; the first two presses are the weighings."""
    source, (low, high, spread), rng = load_sensor(name), _RANGES[name], np.random.default_rng([6, number])
    unit, tools = vary_sensor(source, 800 + number), (*shapes.list_shapes("unseen"), *shapes.list_shapes("task"))
    weighed = [("sphere", low + 0.25 * (high - low), spread / 3), ("sphere", high, spread / 3)]
    held_out = [(tools[k % len(tools)], rng.uniform(low, high), spread) for k in range(_TOOLS)]
    found, true, taken = [], [], []
    for seed, (tool, depth_mm, around_mm) in enumerate(weighed + held_out):
        mesh = shapes.make_shape(tool).mesh
        pose = rigid.translation(*rng.uniform(-around_mm, around_mm, 2), 0.0)
        pose = pose @ rigid.rotation((0.0, 0.0, rng.uniform(-3, 3)))
        pose[2, 3] = -depth_mm - rigid.apply(pose, mesh.vertices_mm)[:, 2].min()
        press = simulate_press(mesh, pose, unit, seed=seed)
        if press.converged and press.force_n >= _LEAST_N:
            depth = read(TactileFrame(sensor=name, image=press.image, reference=unit.render_reference()), source)
            started = time.perf_counter()
            found.append(estimate_all(source, depth.indentation_mm, depth.contact))
            taken.append(1e3 * (time.perf_counter() - started))
            true.append(press.force_n)
    return np.array(found), np.array(true), taken


def measure() -> BenchmarkResult:
    read, rows, notes = build_reader(), [], []
    for name in _RANGES:
        errors, forces, taken = [], [], []
        for number in range(_INSTANCES):
            found, true, ms = press_instance(read, name, number)
            scales = [fit_force_scale(name, column[:2], true[:2]) for column in found.T]
            scaled = np.array([[s.apply(value) for value in c] for s, c in zip(scales, found.T[:, 2:], strict=True)])
            errors.append(np.abs(scaled / true[2:] - 1.0))
            forces.append(np.vstack([scaled, true[2:]]))
            taken += ms
        off, order = np.concatenate(errors, axis=1), 1.0 - stats.spearmanr(np.concatenate(forces, axis=1).T)[0][3]
        lowest = min(stats.spearmanr(of[0], of[3])[0] for of in forces)
        middle, tail = (100.0 * np.quantile(off, q, axis=1) for q in (0.5, 0.9))
        for what, unit, figures, most in (("error", "%", middle, 8.0), ("1 - Spearman of force", "", order, 0.05)):
            rows.append(
                build_measurement(
                    f"{name}: {what}", ours=summarize_times(taken), ours_error=figures[0], unit=unit,
                    peer="volume", peer_error=figures[1], bar=Requirement(max_error=most),
                )
            )  # fmt: skip
        notes.append(
            f"{name}, {off.shape[1]} presses: area times depth {middle[2]:.1f} %, 1 - Spearman {order[2]:.3f}; "
            f"1 - Spearman of the model on the worst instance alone {1 - lowest:.3f}; "
            f"90th percentiles of model, volume, area times depth {' '.join(f'{t:.1f}' for t in tail)} %"
        )
    return BenchmarkResult(title="Force after two weighings", unit="%", rows=tuple(rows), notes=tuple(notes))


if __name__ == "__main__":
    print_result(measure())
