"""Pose by a network that has learned objects by a sensor's own touches: the paper's tactile metric.

It knows where the objects lie that it was taught, in the plane: their shift and turn. An object that it was taught is
known by its mesh, any other is what it takes it for. What a plane does not tell is taken from the touch: the object
stands level on the nearest point that was felt.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Indices, freeze
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Method, Skipped
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.networks import weights_registry
from pipeline.networks.square_images import compute_change, normalise, resize_to_square
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation import shapes
from pipeline.stages.pose import signed_distances
from pipeline.stages.pose.signed_distances import PoseParams
from pipeline.values.results import DepthMap, GeneratedTouch, ObjectPose

if TYPE_CHECKING:
    from torch import nn

_SAME_MM = 1e-3
READS = ("touch", "touch_depth", "target", "mesh")
NOTE = "by network: shift and turn in the plane of an object that it was taught; level, and as high as was felt"


def select_weights(_source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The network that reads touches of this target."""
    return weights_registry.load_for_task("touch_pose", f"pose_{target.name}", file)


def predict_pose(
    touch: GeneratedTouch,
    touch_depth: DepthMap,
    target: SensorSpec,
    mesh: Mesh | None,
    network: nn.Module,
    params: PoseParams,
    progress: Progress = SILENT,
) -> ObjectPose | Skipped:
    """sensor_from_object (4, 4) in mm of the object whose mesh is given, as its network tells it from the picture."""
    nothing = signed_distances.skip_without_contact(touch_depth, mesh, params)
    if nothing is not None or mesh is None:
        assert nothing is not None
        return Skipped(output=nothing, reason=nothing.notes[0])
    untouched = target.render_reference()
    shown = normalise(resize_to_square(compute_change(target.kind, touch.image, untouched)), target.kind)
    x, y, turn = _told(network, shown, mesh)
    level = rigid.translation(x, y, 0.0) @ rigid.rotation((0.0, 0.0, turn))
    at = rigid.invert(target.alignment_from_sensor) @ level
    points, pixel = _felt_points(touch_depth, params)
    nearest = float(points[:, 2].min()) - float(rigid.apply(at, mesh.vertices_mm)[:, 2].min())
    progress.step(1.0, "told")
    return ObjectPose(
        sensor_from_object=freeze(rigid.translation(0.0, 0.0, nearest) @ at), covariance=None, observable=None, weak_directions=(),
        rmse_mm=math.nan, fitness=0.0, scene_mm=points, source_index=pixel, notes=(NOTE,),
    )  # fmt: skip


def _told(network: nn.Module, shown: Floats, mesh: Mesh) -> tuple[float, float, float]:
    """(x mm, y mm, turn rad) of the object's origin in the alignment frame."""
    import torch

    net, label, names = cast("Any", network), _label(mesh), shapes.list_labelled_shapes()
    said = torch.zeros(1, net.n_objects)
    if label is not None and label < net.n_objects:
        said[0, label] = 1.0
    with torch.inference_mode():
        told = net(torch.from_numpy(np.array(shown)[None]), said)
    label = int(told.object_logits[0].argmax()) if label is None else label
    (x, y), headings = told.translation_mm[0].tolist(), told.headings[0].tolist()
    fold = max(1, shapes.make_shape(names[label]).symmetry.fold)
    times = fold if fold <= len(headings) else 1
    cosine, sine = headings[times - 1]
    return x, y, math.atan2(sine, cosine) / times


def _label(mesh: Mesh) -> int | None:
    """Which of the objects that networks are taught this is; None = none of them, vertex for vertex."""
    for label, name in enumerate(shapes.list_labelled_shapes()):
        own = shapes.make_shape(name).mesh.vertices_mm
        if own.shape == mesh.vertices_mm.shape and np.allclose(own, mesh.vertices_mm, atol=_SAME_MM):
            return label
    return None


def _felt_points(touch_depth: DepthMap, params: PoseParams) -> tuple[Floats, Indices]:
    """Contact points (n, 3) in mm and their pixels, `max_points` at most."""
    usable = np.flatnonzero(touch_depth.contact & np.isfinite(touch_depth.depth_mm)).astype(np.int32)
    chosen = usable[:: max(1, math.ceil(len(usable) / params.max_points))]
    points: Doubles = touch_depth.camera.back_project(touch_depth.depth_mm).reshape(-1, 3)[chosen]
    return freeze(points.astype(np.float32)), freeze(chosen)


def _registered(
    touch: GeneratedTouch,  # noqa: ARG001 - what the network in whose place it stands reads
    touch_depth: DepthMap,
    target: SensorSpec,  # noqa: ARG001 - as above
    mesh: Mesh | None,
    params: PoseParams,
    progress: Progress = SILENT,
) -> ObjectPose | Skipped:
    nothing = signed_distances.skip_without_contact(touch_depth, mesh, params)
    if nothing is not None:
        return Skipped(output=nothing, reason=nothing.notes[0])
    return signed_distances.estimate_pose(touch_depth, mesh, params, progress)


REGISTRATION_OF_TOUCH = Method(
    stage="pose",
    name="registration_of_touch",
    title="Signed distances",
    run=_registered,
    params=PoseParams,
    reads=READS,
)
"""In place of a network for which there are no weights; it is no entry of the catalogue."""
