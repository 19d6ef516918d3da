"""A bubble's touch at one alignment, pressed again at another: what is in contact is the object.

Networks from image to image know one alignment of their sensors, at which a bubble comes closest.
At any other the object that it touches there is as far moved as the bubble is, and physics presses
it. Where the source itself measured the object, that is exact, and it replaces the network's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.physics.sensor_images import render_reference
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer
from pipeline.sensors.alignment import Alignment, resolve_alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth import photometric
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch

_BUBBLE = "soft_bubble"  # of the training
_SAME_MM = 0.05  # over a contact
_REACH_MM = 10.0
_PRESSED = "what the network touches at the alignment of its training is pressed at this one"


@derive_once
def get_trained_alignment(source: SensorSpec) -> Alignment:
    """That of the shipped weights: a bubble as close to the object as in the data sets."""
    return resolve_alignment(source, move_bubble_closer(load_sensor(_BUBBLE), BUBBLE_DEEPER_MM))


def find_motion(trained: Alignment, alignment: Alignment) -> Doubles | None:
    """What moves points (4, 4) from the target at one alignment to that at another; None = the
    same.
    """
    motion = alignment.target_from_source @ rigid.invert(trained.target_from_source)
    off_mm = np.linalg.norm(motion[:3, 3]) + _REACH_MM * np.linalg.norm(motion[:3, :3] - np.eye(3))
    return None if off_mm < _SAME_MM else motion


def press_moved_touch(
    touch: GeneratedTouch,
    motion: Doubles,
    view: TargetDepth,
    target: SensorSpec,
    params: PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    """`touch` with its steps as the `target` at another alignment feels it, moved by `motion`.

    `view` is the source's own target depth by that alignment. The contact of a touch without
    membrane is estimated from its image.
    """
    pressed = [
        _press(
            membrane or _estimate_membrane(touch, target), motion, view, target, params, progress
        )
        for membrane in (touch.membrane, *(step.membrane for step in touch.steps))
    ]
    steps = [
        replace(step, image=moved.image, membrane=moved.membrane)
        for step, moved in zip(touch.steps, pressed[1:], strict=True)
        if moved.membrane is not None
    ]
    return replace(
        touch,
        image=pressed[0].image,
        membrane=pressed[0].membrane,
        notes=(*touch.notes, *pressed[0].notes, _PRESSED),
        steps=tuple(steps),
    )


def _estimate_membrane(touch: GeneratedTouch, target: SensorSpec) -> DepthMap:
    frame = TactileFrame(
        sensor=target.name,
        image=touch.image,
        reference=render_reference(target),
        camera=touch.camera,
    )
    return photometric.estimate_depth(frame, target, None, DepthParams())


def _press(
    membrane: DepthMap,
    motion: Doubles,
    view: TargetDepth,
    target: SensorSpec,
    params: PhysicalRenderParams,
    progress: Progress,
) -> GeneratedTouch:
    between = Alignment(alignment_from_source=np.eye(4), target_from_alignment=motion)
    cloud = back_project_depth(membrane, between, BackProjectionParams())
    moved = project_cloud(cloud, target, SurfaceProjectionParams())
    measured = np.isfinite(view.depth_mm)
    object_view = replace(
        moved,
        depth_mm=freeze(np.where(measured, view.depth_mm, moved.depth_mm)),
        indentation_mm=freeze(np.where(measured, view.indentation_mm, moved.indentation_mm)),
        contact=freeze(np.where(measured, view.contact, moved.contact)),
        in_view=freeze(np.ones(measured.shape, np.bool_)),
        notes=view.notes,
    )
    touch = render_touch(object_view, target, params, progress)
    assert touch.membrane is not None
    return replace(
        touch,
        membrane=replace(
            touch.membrane, is_generated=True, expected_error_mm=membrane.expected_error_mm
        ),
    )
