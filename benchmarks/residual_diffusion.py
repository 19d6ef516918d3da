"""What does the compact diffusion add to the physical render, in how many steps, and do its samples know their error?

    python benchmarks/residual_diffusion.py [TARGET] [SOURCE] [quick]

Objects that it was taught on, held as it has never seen, and tools that nothing was chosen by are pressed on a GelSlim
and on a bubble (apex pushed in by 13 mm, as in data sets). The source is another unit than described and has recorded
a reading, which goes the whole way to the target's touch; the target is the described unit. Errors are mean absolute
differences of the target's indentation: in its true contact, over all, inside and outside what the source could feel.
One step is the middle of all samples, four and eight are samples; 200 guided steps are the paper's setting. Of no
source was ever a pair seen; `quick` asks one step alone.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.image_similarity import compute_similarity
from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.base.progress import SILENT
from pipeline.engine.graph import Fallback, Skipped
from pipeline.geometry import rigid
from pipeline.metrics.stage_metrics import iou
from pipeline.physics import bubble_camera, optics
from pipeline.racing.results import BenchmarkResult, PlotPoint
from pipeline.racing.text_report import print_result
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import datasets, poses, shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.stage import STAGE as DEPTH
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from pipeline.stages.touch.stage import PHYSICS, T2D2
from pipeline.values.frames import TactileFrame

_SPLITS = {"unseen grasps": ("training", 2), "unseen tools": ("unseen", 4)}  # group, grasps of each object
_SHARES = {"unseen grasps": 0.5, "unseen tools": 0.75}  # of physics' error in contact that may be left, for a bubble
_DIRECTIONS = (
    ("gelslim", "soft_bubble"), ("soft_bubble", "gelslim"), ("digit", "soft_bubble"), ("gelsight_mini", "soft_bubble"),
    ("digit", "gelslim"), ("gelsight_mini", "gelslim"),
)  # fmt: skip
_WAYS = {"1 step": DiffusionParams(), "4 steps": DiffusionParams(steps=4), "8 steps": DiffusionParams(steps=8)}
_PAPER = DiffusionParams(steps=200, guidance=2.54)
_LONG, _SEEDS, _SPREAD_TOUCHES = 1, 6, 4  # touches of the paper's setting; samples and touches of the calibration
_REGIONS = ("in contact", "over all", "inside the view", "outside the view")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Felt:
    """A touch on its way to the target, and what the target really felt."""

    view: object
    truth_mm: np.ndarray
    contact: np.ndarray
    image: np.ndarray
    known: np.ndarray


def measure(only_target: str = "", only_source: str = "", quick: str = "") -> BenchmarkResult:
    rows, points, notes = [], [], []
    asked = [d for d in _DIRECTIONS if only_source in ("", d[0]) and only_target in ("", d[1])]
    ways = dict(list(_WAYS.items())[:1]) if quick else _WAYS
    for source, target in asked:
        for split, (group, grasps) in _SPLITS.items():
            felt = _all_felt(source, target, group, grasps)
            _race(f"{source} to {target}, {split}", split, felt, _described(target), rows, points, notes, ways)
            if not quick:
                about = (
                    _long(felt[:_LONG], _described(target)),
                    _calibration(felt[:_SPREAD_TOUCHES], _described(target)),
                )
                notes += [f"{source} to {target}, {split}: {said}" for said in about]
    return BenchmarkResult(
        title="residual diffusion beside the physical render", unit="mm", rows=tuple(rows), points=tuple(points),
        notes=tuple(notes),
    )  # fmt: skip


def _race(what, split, touches, target, rows, points, notes, ways) -> None:
    by_physics, spent = _touches(PHYSICS, PhysicalRenderParams(), touches, target)
    theirs = _errors(by_physics, touches)
    notes.append(f"{what}: {len(touches)} touches; physics {_said(by_physics, touches, target)}")
    for way, params in ways.items():
        made, taken = _touches(T2D2, params, touches, target)
        if made is None:
            notes.append(f"{what}: {taken}")
            return
        ours = _errors(made, touches)
        for k, region in enumerate(_REGIONS):
            closer = {0: 1 / _SHARES[split] if target.kind == "bubble" else 1.0, 1: 1.0}.get(k)
            bar = Requirement(min_error_ratio=closer) if way == "1 step" and closer else Requirement()
            rows.append(build_measurement(f"{what}, {way}: {region}", peer="physics", ours=taken, peer_timing=spent, unit="mm",
                            ours_error=ours[k], peer_error=theirs[k], bar=bar))  # fmt: skip
        points.append(PlotPoint(method=f"{what}, {way}", ms=taken.median_ms, error=ours[0], ours=True))
        notes.append(f"{what}: {way} {_said(made, touches, target)}")


def _long(touches, target) -> str:
    """The paper's number of steps and guidance beside one and eight steps of the same network, physics left out."""
    told = []
    for params in (_PAPER, DiffusionParams(), DiffusionParams(steps=8)):
        made, taken = _touches(T2D2, params, touches, target)
        _, without = _touches(T2D2, replace(params, steps=0), touches, target)
        alike = np.mean(
            [compute_similarity(m.image, f.image, _range(target)) for m, f in zip(made, touches, strict=True)]
        )
        name = f"{params.steps} steps at {params.guidance:g}"
        told.append(f"{name} {taken.median_ms - without.median_ms:.0f} ms, SSIM {alike:.4f}")
    return "; ".join(told)


def _calibration(touches, target) -> str:
    """How large the spread over seeds is where the error of the samples' mean is of some size, and how they agree."""
    spread, off, told = [], [], []
    for f in touches:
        made = [_touches(T2D2, DiffusionParams(steps=8, seed=s), [f], target)[0][0].membrane for s in range(_SEEDS)]
        stack = np.stack([m.indentation_mm for m in made])
        spread.append(stack.std(0, ddof=1).ravel())
        off.append(np.abs(stack.mean(0) - f.truth_mm).ravel())
        told.append(made[0].spread_mm.ravel())
    spread, off, told = map(np.concatenate, (spread, off, told))
    said = []
    for name, guess in (("spread over seeds", spread), ("said spread", told)):
        order = np.array_split(np.argsort(guess), 5)
        fifths = ", ".join(f"{guess[o].mean():.2g}/{off[o].mean():.2g}" for o in order)
        said.append(f"{name} against error by fifths {fifths} mm")
    return "; ".join(said)


def _all_felt(source: str, target: str, group: str, grasps: int) -> list[_Felt]:
    return [f for k, name in enumerate(shapes.list_shapes(group) * grasps) if (f := _felt(source, target, name, k))]


def _felt(source_name: str, target_name: str, name: str, k: int) -> _Felt | None:
    thing = shapes.make_shape(name).mesh
    pose = poses.sample_press_pose(thing, np.random.default_rng([13, k]))
    described, target = _described(source_name), _described(target_name)
    unit = vary_sensor(described, 900 + k)
    reading = simulate_press(thing, pose, unit, seed=2 * k)
    if not reading.truth.contact.any():
        return None
    own = simulate_press(thing, pose, target, seed=None)
    if unit.kind == "gel":
        reference = optics.render_reference(unit)
    else:
        reference = bubble_camera.simulate_depth_frame(unit, unit.rest_depth_mm, 2 * k + 1)
    frame = TactileFrame(sensor=source_name, image=reading.image, reference=reference)
    cloud = back_project_depth(
        _read(frame, described), alignment.resolve_alignment(described, target), BackProjectionParams()
    )
    view = project_cloud(cloud, target, SurfaceProjectionParams())
    if not own.truth.contact.any() or not view.contact.any():
        return None
    truth = own.truth
    return _Felt(
        view=view, truth_mm=truth.indentation_mm, contact=truth.contact, image=own.image, known=view.in_view
    )  # fmt: skip


def _read(frame: TactileFrame, source):
    """The depth of a frame, by the method that is meant for its kind of sensor."""
    method = DEPTH.methods[0]
    extra = () if method.weights is None else (method.weights(source, source, None),)
    found = method.run(frame, source, None, *extra, method.params(), SILENT)
    found = found.answer if isinstance(found, Fallback) else found
    return found.output if isinstance(found, Skipped) else found


def _described(name: str):
    spec = load_sensor(name)
    if spec.kind != "bubble":
        return spec
    nearer = rigid.translation(0.0, 0.0, datasets.BUBBLE_DEEPER_MM) @ spec.alignment_from_sensor
    return replace(spec, alignment_from_sensor=nearer)


def _touches(method, params, touches, target):
    """(touches, time), or (None, why) where there are no weights."""
    extra = () if method.weights is None else (method.weights(target, target, None),)
    made, taken = [], []
    for f in touches:
        started = time.perf_counter()
        touch = method.run(f.view, target, *extra, params, SILENT)
        taken.append(1e3 * (time.perf_counter() - started))
        if isinstance(touch, Fallback):
            return None, touch.why
        made.append(touch.output if isinstance(touch, Skipped) else touch)
    return made, summarize_times(taken)


def _errors(made, touches) -> tuple[float, ...]:
    found = []
    for touch, f in zip(made, touches, strict=True):
        off = np.abs(touch.membrane.indentation_mm - f.truth_mm)
        regions = (f.contact, np.ones_like(f.contact), f.known, ~f.known)
        found.append([off[r].mean() if r.any() else np.nan for r in regions])
    return tuple(np.nanmean(found, axis=0)) if np.isfinite(found).any() else (np.nan,) * 4


def _said(made, touches, target) -> str:
    overlap = np.mean([iou(m.membrane.contact, f.contact) for m, f in zip(made, touches, strict=True)])
    pairs = [(np.asarray(m.image, float), np.asarray(f.image, float)) for m, f in zip(made, touches, strict=True)]
    span = _range(target)
    noise = np.mean([min(100.0, 10 * np.log10(span**2 / max(((a - b) ** 2).mean(), 1e-12))) for a, b in pairs])
    alike = np.mean([compute_similarity(m.image, f.image, _range(target)) for m, f in zip(made, touches, strict=True)])
    return f"IoU {overlap:.3f}, PSNR {noise:.2f} dB, SSIM {alike:.4f}"


def _range(target) -> float:
    return 255.0 if target.kind == "gel" else target.limits.indentation_max_mm


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
