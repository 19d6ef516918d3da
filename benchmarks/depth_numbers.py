"""What is each number of the depth stage worth? Its errors with that number a third smaller and half as large again.

    python benchmarks/depth_numbers.py [PART OF A NAME]

Training objects are pressed on a simulated bubble (seen by a time-of-flight and a stereo camera) and on gels (a DIGIT,
the dotless GelSlim, a GelSight Mini), every other one on a unit that differs from its description. An error is the
geometric mean of 1 - IoU of the contact and of the mean absolute depth in it and beside it, over all presses; it is
told relative to that of the numbers as they are. The peer of a number is the better of its two neighbours: what stands
in the code is right where no neighbour is clearly better, and does not matter where both come out alike.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, Timing, build_measurement
from pipeline.base.arrays import freeze
from pipeline.geometry import rigid
from pipeline.metrics.stage_metrics import iou, mean_abs_mm
from pipeline.physics import optics
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import poses, shapes
from pipeline.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import (
    bubble_contact,
    change_detection,
    gel_depth,
    membrane_load,
    rest_level,
    surface_refinement,
)
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

NEEDS = "five minutes"
_BAR = Requirement(min_error_ratio=0.97)  # a neighbour that is better by no more than the choice of presses makes
_FACTORS = (2 / 3, 1.5)
_PARAMS = DepthParams()
_GEL_DEPTHS_MM = (0.2, 0.5)
_LEFT_OUT = {  # what has a reason beside it in the code
    bubble_contact: {"_MOST_PIXELS", "_USUAL_CURVATURE_PER_MM", "_SPECKLE_PX"},
    membrane_load: {"_ITERATIONS", "_SPREADS", "_FREED", "_FEWEST_BLOCKS"},
    surface_refinement: {"_CELLS", "_NO_BLUR"},
    gel_depth: {"_SATURATED_GREY", "_FULL_SHARE", "_PRESSURE_CELLS"},
    change_detection: {"_BLOCK_PX"},
    rest_level: {"_CELLS", "_STEPS", "_EXACT", "_FAR_MM", "_FAR_STEPS"},
}  # fmt: skip


def list_constants(module):
    """The module's own numbers."""
    left_out = _LEFT_OUT[module]
    for name, value in vars(module).items():
        is_number = isinstance(value, (int, float, np.floating)) and not isinstance(value, bool)
        if is_number and name.startswith("_") and name.isupper() and name not in left_out:
            yield name, value


def scale_constant(value, factor):
    """The number beside `value`; whole ones stay whole."""
    if not isinstance(value, int):
        return type(value)(value * factor)
    return value + (round(value * (factor - 1)) or (1 if factor > 1 else -1))


class ChangedConstant:
    """A module with one number changed, for as long as the block lasts."""

    def __init__(self, module, name, value):
        self.module, self.name, self.value = module, name, value

    def __enter__(self):
        self.before = getattr(self.module, self.name)
        setattr(self.module, self.name, self.value)
        membrane_load._lines.memo.clear()

    def __exit__(self, *_):
        setattr(self.module, self.name, self.before)
        membrane_load._lines.memo.clear()


def bubbles():
    """(frame, sensor, truth) of a bubble, far out and less far."""
    for index, name in enumerate(shapes.list_shapes("training")):
        told = load_sensor(("soft_bubble", "soft_bubble_stereo")[index % 2])
        pose = np.array(told.alignment_from_sensor)
        pose[2, 3] += BUBBLE_DEEPER_MM * (index // 2 % 2)
        felt_by = replace(told, alignment_from_sensor=freeze(pose))
        thing = shapes.make_shape(name).mesh
        felt = simulate_press(thing, poses.make_paper_grid(thing, n=12, seed=index)[3], felt_by, seed=index)
        yield frame_of(told, felt.image, told.rest_depth_mm.astype(np.float32)), told, felt.truth


def gels():
    """(frame, sensor, truth) of gels, pressed lightly and firmly."""
    for index, name in enumerate(shapes.list_shapes("training")[1::2]):
        told = load_sensor(("digit", "gelslim_dotless", "digit", "gelsight_mini")[index % 4])
        unit = vary_sensor(told, index) if index % 2 else told
        thing = shapes.make_shape(name).mesh
        for depth_mm in _GEL_DEPTHS_MM:
            pose = rigid.rotation((0.0, 0.0, 0.3 * index))
            pose[2, 3] = -depth_mm - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
            felt = simulate_press(thing, pose, unit, seed=index)
            if felt.converged and felt.truth.contact.any():
                yield frame_of(told, felt.image, optics.render_reference(unit)), told, felt.truth


def frame_of(source, image, reference):
    return TactileFrame(sensor=source.name, image=image, reference=reference)


def errors(presses):
    """Of every press: the logarithms of (1 - IoU, mm in the contact, mm beside it)."""
    found = []
    for frame, told, truth in presses:
        answer = estimate_depth(frame, told, None, _PARAMS)
        moved, true = answer.indentation_mm, truth.indentation_mm
        parts = (1 - iou(answer.contact, truth.contact), mean_abs_mm(moved, true, truth.contact),
                 mean_abs_mm(moved, true, ~truth.contact))  # fmt: skip
        found.append(np.log(np.maximum(parts, 1e-4)))
    return np.array(found)


def measure(part: str = "") -> BenchmarkResult:
    rows, notes = [], []
    for presses, modules in (
        (list(bubbles()), (membrane_load, bubble_contact)),
        (list(gels()), (gel_depth, surface_refinement)),
    ):
        usual = errors(presses)
        parts = ", ".join(f"{e:.3f}" for e in np.exp(usual.mean(axis=0)))
        notes.append(
            f"{len(presses)} presses on a {presses[0][1].kind}: 1 - IoU, mm in the contact, mm beside: {parts}"
        )
        for module in modules:
            for name, value in list_constants(module):
                title = f"{module.__name__.rpartition('.')[2]}.{name} = {value:g}"
                if part in title:
                    rows.append(_judged(title, module, name, value, presses, usual))
    return BenchmarkResult(title="Numbers of the depth stage beside their neighbours", unit="relative", rows=tuple(rows),
                  notes=tuple(notes))  # fmt: skip


def _judged(title, module, name, value, presses, usual):
    relative = {}
    for factor in _FACTORS:
        beside = scale_constant(value, factor)
        with ChangedConstant(module, name, beside):
            relative[beside] = float(np.exp((errors(presses) - usual).mean()))
    told = ", ".join(f"{beside:.3g}: {ratio:.3f}" for beside, ratio in relative.items())
    best = min(relative, key=relative.__getitem__)
    untimed = Timing(median_ms=math.nan, p95_ms=math.nan)
    return build_measurement(
        title, peer=told, ours=untimed, ours_error=1.0, peer_error=relative[best], unit="relative", bar=_BAR
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
