"""How well does a bubble's depth predict a GelSlim's touch? The depth network against the load on
the membrane.

    python -m benchmarks.bubble_network

Objects that the network was trained on, held as it has never seen, and tools that nothing was
chosen by are pressed on a bubble (apex pushed in by 13 mm, as in data sets) and on a GelSlim, each
on other sensor instances than those described (`varied`, strength 1), with the bubble's noise in
the touched and in the untouched reading. What is read goes the whole way, depth to cloud to view to
the GelSlim's gel pressed onto it; errors are those of that gel against the gel that was really
pressed: 1 - intersection over union of contact, and the mean absolute difference of indentation in
the true contact. Next to it what is left when the exact membrane, or the exact surface of the
object close behind it, takes the place of the reading. Untouched frames of a real bubble (Punyo),
where they are at hand, must show no contact.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times, time_in_turns
from benchmarks.scenes.depth_helpers import build_reader
from pipeline.core.geometry import rigid
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.io import open_recording
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation import datasets, poses, shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.metrics.stage_metrics import compute_mae_mm, iou
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch

_BARS = {"unseen grasps": (0.20, 0.10), "unseen tools": (0.35, 0.15)}
_GRASPS = {"unseen grasps": 1, "unseen tools": 2}  # of each object
_NEAR_MM = 0.5  # behind the membrane: where the exact surface is reported
_PEER = "load on the membrane"
_PUNYO = (
    Path(os.environ.get("TACTILE_DATA", "../shared/data")) / "punyo_bubble" / "depth_sequence.npz"
)
_PUNYO_UNTOUCHED = range(1, 5)  # frames; the first is the reference


def measure() -> BenchmarkResult:
    methods = {"ours": build_reader("network"), _PEER: build_reader("physics")}
    rows = []
    notes = []
    for split, bars in _BARS.items():
        touches = list(_touches(split))
        for kind in ("soft_bubble", "soft_bubble_stereo"):
            found = {name: _through(read, touches, kind) for name, read in methods.items()}
            for k, (what, unit) in enumerate(
                (("contact", "1 - IoU"), ("indentation in contact", "mm"))
            ):
                rows.append(
                    build_measurement(
                        f"{kind} to GelSlim, {split}: {what}",
                        ours=summarize_times(found["ours"][1]),
                        peer=_PEER,
                        unit=unit,
                        peer_timing=summarize_times(found[_PEER][1]),
                        ours_error=found["ours"][0][k],
                        peer_error=found[_PEER][0][k],
                        bar=Requirement(max_error=bars[k]),
                    )
                )
        for name, exact in (("membrane", _membrane), ("surface of the object", _object)):
            left = np.nanmean([_felt(exact(touch), touch) for touch in touches], axis=0)
            notes.append(
                f"{split}, exact {name} in place of a reading: {left[0]:.3f} 1 - IoU, "
                f"{left[1]:.3f} mm"
            )
    if _PUNYO.exists():
        rows += _untouched(methods)
    return BenchmarkResult(
        title="GelSlim's contact from a bubble's reading",
        unit="1 - IoU",
        rows=tuple(rows),
        notes=tuple(notes),
    )


class _Touch:
    """One press, observed by another sensor instance of the bubble and of the GelSlim."""

    def __init__(self, name: str, k: int) -> None:
        thing = shapes.make_shape(name).mesh
        pose = poses.sample_press_pose(thing, np.random.default_rng([11, k]))
        described = load_sensor("soft_bubble")
        nearer = (
            rigid.translation(0.0, 0.0, datasets.BUBBLE_DEEPER_MM) @ described.alignment_from_sensor
        )
        self.source = replace(described, alignment_from_sensor=nearer)
        self.unit = vary_sensor(self.source, 300 + k)
        self.gel = vary_sensor(load_sensor("gelslim"), 500 + k)
        self.seed = 2 * k
        self.bubble, self.truth = (
            simulate_press(thing, pose, unit, seed=None).truth for unit in (self.unit, self.gel)
        )
        vertices = rigid.apply(self.bubble.sensor_from_object, thing.vertices_mm)
        self.object_mm = render_mesh(vertices, thing.triangles, self.unit.camera)[0]
        self.depth_mm = self.unit.rest_depth_mm - self.bubble.indentation_mm

    def frame(self, kind: str) -> TactileFrame:
        """What the bubble reads through this kind of depth camera."""
        unit = replace(self.unit, depth_camera=load_sensor(kind).depth_camera)
        nothing = np.zeros_like(self.bubble.indentation_mm)
        image = render_sensor_image(unit, self.bubble.indentation_mm, self.depth_mm, self.seed)
        reference = render_sensor_image(unit, nothing, unit.rest_depth_mm, self.seed + 1)
        return TactileFrame(sensor=kind, image=image, reference=reference)


def _touches(split: str):
    names = shapes.list_shapes("training" if split == "unseen grasps" else "unseen")
    for k, name in enumerate(names * _GRASPS[split]):
        touch = _Touch(name, k)
        if touch.truth.contact.any():
            yield touch


def _through(read, touches, kind: str):
    """(mean errors, ms of each reading) of a method."""
    found = []
    taken = []
    for touch in touches:
        frame = touch.frame(kind)
        started = time.perf_counter()
        depth = read(frame, touch.source)
        taken.append(1e3 * (time.perf_counter() - started))
        found.append(_felt(depth, touch))
    return np.mean(found, axis=0), taken


def _felt(depth: DepthMap, touch: _Touch) -> tuple[float, float]:
    """(1 - IoU, mm in contact) of the GelSlim's gel that is pressed onto what the bubble's depth
    tells.
    """
    gel = load_sensor("gelslim")
    cloud = back_project_depth(
        depth, alignment.resolve_alignment(touch.source, gel), BackProjectionParams()
    )
    membrane = render_touch(
        project_cloud(cloud, gel, SurfaceProjectionParams()), gel, PhysicalRenderParams()
    ).membrane
    truth = touch.truth
    return 1 - iou(membrane.contact, truth.contact), compute_mae_mm(
        membrane.indentation_mm, truth.indentation_mm, truth.contact
    )


def _membrane(touch: _Touch) -> DepthMap:
    return DepthMap(
        indentation_mm=touch.bubble.indentation_mm,
        depth_mm=touch.depth_mm.astype(np.float32),
        contact=touch.bubble.contact,
        camera=touch.unit.camera,
        source_index=make_pixel_index(touch.unit.camera.shape),
    )


def _object(touch: _Touch) -> DepthMap:
    near = touch.object_mm - touch.depth_mm < _NEAR_MM
    return replace(
        _membrane(touch), object_depth_mm=np.where(near, touch.object_mm, np.nan).astype(np.float32)
    )


def _untouched(methods):
    """Contact pixels, in thousandths of the frame, on frames without contact of a real bubble."""
    stream = open_recording(_PUNYO, sensor="soft_bubble_stereo").stream()
    source = load_sensor("soft_bubble_stereo")
    frames = [stream.frame(k) for k in _PUNYO_UNTOUCHED]
    wrong = {
        name: 1e3 * np.mean([read(f, source).contact.mean() for f in frames])
        for name, read in methods.items()
    }
    times = time_in_turns(
        {name: partial(read, frames[0], source) for name, read in methods.items()}, runs=5
    )
    yield build_measurement(
        "untouched frames of a real bubble: contact",
        unit="of 1000",
        ours=times["ours"],
        ours_error=wrong["ours"],
        peer=_PEER,
        peer_timing=times[_PEER],
        peer_error=wrong[_PEER],
        bar=Requirement(max_error=0.0),
    )


if __name__ == "__main__":
    print_result(measure())
