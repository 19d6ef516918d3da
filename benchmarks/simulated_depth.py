"""How accurate is depth of simulated presses? Unseen tools on other sensor instances, flat faces,
very light presses.

    python -m benchmarks.simulated_depth [METHOD]

METHOD is a method of the stage *depth* (default by sensor). Tools that no number was chosen by are
pressed by 0.15, 0.4 and 0.8 mm at random places and turns, each on another sensor instance
(`varied`, strength 1) than the one that depth is reported of. The error of contact is 1 -
intersection over union with the pixels under pressure; that of depth the mean absolute difference
in the true contact. Boxes with a level face, 0.2 to 1.2 of the view's shorter side wide, are
pressed by 0.5 mm in the middle of the view, on the described sensor and on another. Very light
presses, 0.02 to 0.12 mm of tools and training objects on other sensor instances: Spearman's order
of the measured volume (the sum of the indentation) against the force. Recordings: eight presses of
all three depths on one unit, each read alone and by the light that four of them tell together, as
when they are frames of one recording. Noted next to: the contact that the rule finds in exact
depth, so that what is left is depth's, and the order that the true volume has: units differ in
stiffness and thickness, which no volume tells.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import build_reader
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import Stream, TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import contact
from pipeline.stages.depth.gel.settings import CONTACT
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.metrics.stage_metrics import compute_mae_mm, iou
from pipeline.translation.frame_selection import select_context_frames

_SENSORS = ("gelslim", "gelsight_mini", "digit")
_DEPTHS_UM = {0.15: 15.0, 0.4: 25.0, 0.8: 45.0}  # and what the error in the contact may be
_FACES = (0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.2)
_FACE_MM = 0.5
_LIGHT_MM = (0.02, 0.12)
_LIGHT_PRESSES = 32
_RECORDINGS = 4
_FRAMES = 8


def measure_press(read, source, unit, thing, *, depth_mm, place, turn, seed):
    """(result, truth, force, ms) of a press whose foremost point goes in by `depth_mm`.

    None without contact.
    """
    touched = press_foremost(unit, thing, depth_mm=depth_mm, place=place, turn=turn, seed=seed)
    if touched is None:
        return None
    frame = TactileFrame(
        sensor=source.name, image=touched.image, reference=optics.render_reference(unit)
    )
    started = time.perf_counter()
    answer = read(frame, source)
    return answer, touched.truth, touched.force_n, 1e3 * (time.perf_counter() - started)


def press_foremost(unit, thing, *, depth_mm, place, turn, seed):
    """A press whose foremost point goes in by `depth_mm`; None where it is not observed."""
    pose = rigid.translation(*place, 0.0) @ rigid.rotation((0.0, 0.0, turn))
    pose[2, 3] = -depth_mm - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
    touched = simulate_press(thing, pose, unit, seed=seed)
    return touched if touched.converged and touched.truth.contact.any() else None


def draw_place(rng, reach_mm: float):
    """Place (mm) and turn (rad) of a press at random."""
    return {"place": rng.uniform(-reach_mm, reach_mm, 2), "turn": rng.uniform(-3, 3)}


def by_rule(indentation_mm, source):
    """The contact that the rule finds in exact depth."""
    return contact.detect_contact(
        indentation_mm,
        source.pixel_mm,
        least_mm=source.limits.contact_min_mm,
        pressure_share=DepthParams().pressure_share,
        settings=CONTACT,
    )


def tools(read, name: str):
    """Rows of one sensor, and what they hide."""
    source = load_sensor(name)
    for depth_mm, most_um in _DEPTHS_UM.items():
        rng = np.random.default_rng(round(1000 * depth_mm))
        found = []
        for index, tool in enumerate(shapes.list_shapes("unseen")):
            unit = vary_sensor(source, 100 + index)
            mesh = shapes.make_shape(tool).mesh
            touched = measure_press(
                read, source, unit, mesh, depth_mm=depth_mm, seed=index, **draw_place(rng, 2.5)
            )
            if touched is not None:
                answer, truth, _, ms = touched
                inside = truth.contact
                off = [
                    1e3 * compute_mae_mm(answer.indentation_mm, truth.indentation_mm, of)
                    for of in (inside, ~inside)
                ]
                off.append(
                    1e3
                    * compute_mae_mm(scale_to_truth(answer, truth), truth.indentation_mm, inside)
                )
                exact = iou(by_rule(truth.indentation_mm, source), inside)
                found.append((1 - iou(answer.contact, inside), *off, exact, ms))
        wrong, inside_um, outside_um, shape_um, exact, ms = np.array(found).T
        label = f"{name}, unseen tools, {depth_mm:g} mm"
        note = (
            f"{label}: IoU of each {_listed(1 - wrong)}; by the rule in exact depth "
            f"{_listed(exact)}"
        )
        figures = (
            ("contact", wrong, "1 - IoU", 0.10),
            ("depth in contact", inside_um, "um", most_um),
        )
        yield (
            tuple(
                build_measurement(
                    f"{label}: {what}",
                    ours=summarize_times(ms),
                    ours_error=values.mean(),
                    unit=unit,
                    bar=Requirement(max_error=most),
                )
                for what, values, unit, most in figures
            ),
            (
                f"{note}; outside the contact {outside_um.mean():.1f} um; in it, were each "
                "touch's scale known, "
                f"{shape_um.mean():.1f} um"
            ),
        )


def scale_to_truth(answer, truth):
    """The indentation read, times what brings it nearest to the true one in its contact: what is
    left is shape.
    """
    seen, true = (
        field.indentation_mm[truth.contact].astype(np.float64) for field in (answer, truth)
    )
    return answer.indentation_mm * np.float32((seen @ true) / max(float(seen @ seen), 1e-9))


def recordings(read, name: str):
    """Errors of depth with the light pooled over a recording, next to that of each frame by
    itself.
    """
    source = load_sensor(name)
    tools_ = shapes.list_shapes("unseen")
    rng = np.random.default_rng(11)
    alone = {d: [] for d in _DEPTHS_UM}
    pooled = {d: [] for d in _DEPTHS_UM}
    taken = []
    for number in range(_RECORDINGS):
        unit = vary_sensor(source, 300 + number)
        touched = []
        for index in range(_FRAMES):
            depth_mm = tuple(_DEPTHS_UM)[(index + number) % len(_DEPTHS_UM)]
            mesh = shapes.make_shape(tools_[(index + number) % len(tools_)]).mesh
            found = press_foremost(
                unit, mesh, depth_mm=depth_mm, seed=index, **draw_place(rng, 2.5)
            )
            if found is not None:
                touched.append((depth_mm, found))
        frames = [
            TactileFrame(
                sensor=name, image=one.image, reference=optics.render_reference(unit), index=index
            )
            for index, (_, one) in enumerate(touched)
        ]
        stream = Stream(name=name, sensor=name, n_frames=len(frames), frame=frames.__getitem__)
        outside = [frame.image for frame in select_context_frames(stream)]
        for frame, (depth_mm, one) in zip(frames, touched, strict=True):
            inside = one.truth.contact
            for of, touches in ((alone, ()), (pooled, outside)):
                started = time.perf_counter()
                answer = read(replace(frame, context_frames=touches), source)
                if touches:
                    taken.append(1e3 * (time.perf_counter() - started))
                of[depth_mm].append(
                    1e3 * compute_mae_mm(answer.indentation_mm, one.truth.indentation_mm, inside)
                )
    rows = tuple(
        build_measurement(
            f"{name}, recordings of {_FRAMES}, {depth_mm:g} mm: depth in contact",
            peer="each alone",
            ours=summarize_times(taken),
            ours_error=float(np.mean(pooled[depth_mm])),
            peer_error=float(np.mean(alone[depth_mm])),
            unit="um",
            bar=Requirement(max_error=most_um),
        )
        for depth_mm, most_um in _DEPTHS_UM.items()
    )
    return rows, ""


def faces(read, name: str):
    source = load_sensor(name)
    side_mm = min(source.camera.shape) * source.pixel_mm
    overlap = []
    off = []
    taken = []
    for share in _FACES:
        half = 0.5 * share * side_mm
        box = shapes.make_chamfered_prism(
            [(-half, -half), (half, -half), (half, half), (-half, half)], 8.0, 0.0, "box"
        )
        for unit in (source, vary_sensor(source, round(100 * share))):
            answer, truth, _, ms = measure_press(
                read, source, unit, box, depth_mm=_FACE_MM, place=(0, 0), turn=0.0, seed=3
            )
            overlap.append(iou(answer.contact, truth.contact))
            off.append(
                1e3 * compute_mae_mm(answer.indentation_mm, truth.indentation_mm, truth.contact)
            )
            taken.append(ms)
    found = build_measurement(
        f"{name}, flat faces: contact",
        ours=summarize_times(taken),
        ours_error=1 - float(np.mean(overlap)),
        unit="1 - IoU",
        bar=Requirement(max_error=0.07),
    )
    return (found,), (
        f"{name}, flat faces of {', '.join(f'{s:g}' for s in _FACES)} of the view: IoU on that "
        "instance "
        f"{_listed(overlap[::2])}, on another {_listed(overlap[1::2])}; depth in contact off by "
        f"{np.mean(off):.0f} um"
    )


def light(read, name: str):
    from scipy import stats

    source = load_sensor(name)
    rng = np.random.default_rng(7)
    things = (*shapes.list_shapes("unseen"), *shapes.list_shapes("training"))
    volume = []
    true_volume = []
    force = []
    taken = []
    for index in range(_LIGHT_PRESSES):
        unit = vary_sensor(source, index)
        mesh = shapes.make_shape(things[index % len(things)]).mesh
        depth_mm = rng.uniform(*_LIGHT_MM)
        touched = measure_press(
            read, source, unit, mesh, depth_mm=depth_mm, seed=index, **draw_place(rng, 2.0)
        )
        if touched is not None:
            answer, truth, newton, ms = touched
            true_volume.append(float(truth.indentation_mm.sum(dtype=np.float64)))
            volume.append(float(answer.indentation_mm.sum(dtype=np.float64)))
            force.append(newton)
            taken.append(ms)
    order = float(stats.spearmanr(volume, force).statistic)
    found = build_measurement(
        f"{name}, very light presses: 1 - order of volume against force",
        ours=summarize_times(taken),
        ours_error=1 - order,
        unit="",
        bar=Requirement(max_error=0.05),
    )
    exact = float(stats.spearmanr(true_volume, force).statistic)
    return (found,), f"{name}, very light presses: order of the true volume {exact:.3f}"


def _listed(values) -> str:
    return " ".join(f"{v:.2f}" for v in values)


def measure(method: str = "") -> BenchmarkResult:
    read = build_reader(method)
    found = [
        part
        for name in _SENSORS
        for part in (
            *tools(read, name),
            recordings(read, name),
            faces(read, name),
            light(read, name),
        )
    ]
    return BenchmarkResult(
        title=f"Depth of simulated presses on other units by {method}",
        unit="1 - IoU",
        rows=tuple(r for rows, _ in found for r in rows),
        notes=tuple(note for _, note in found if note),
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
