"""Object pose by a network trained on a sensor's own touches: the paper's tactile metric.

The network estimates translation and rotation in the plane of objects that it was trained on. A
trained object is identified by its mesh; for any other mesh the network's class is used. Tilt is
taken as 0, and the height is that of the contact point nearest to the camera.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Indices, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.graph import Method, Skipped
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap, GeneratedTouch, ObjectPose
from pipeline.physics.sensor_images import render_reference
from pipeline.physics.simulation import shapes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.touch_formats import normalise, resize_to_square
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.pose import signed_distances
from pipeline.stages.pose.signed_distances import PoseParams

if TYPE_CHECKING:
    from torch import nn

_SAME_MM = 1e-3  # tolerance of vertices of the same mesh
READS = ("touch", "touch_depth", "target", "mesh")
NOTE = (
    "pose by network: planar translation and rotation of a trained object; tilt 0, height "
    "from the contact"
)


def select_weights(
    _source: SensorSpec, target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The pose network of this target sensor."""
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
    """Predict sensor_from_object (4, 4) in mm of the given mesh from the tactile image."""
    skipped = signed_distances.skip_without_contact(touch_depth, mesh)
    if skipped is not None or mesh is None:
        assert skipped is not None
        return Skipped(output=skipped, reason=skipped.notes[0])
    reference = render_reference(target)
    square = normalise(
        resize_to_square(target.sensor_kind.compute_relative_change(touch.image, reference)),
        target.kind,
    )
    x, y, angle_rad = _predict_planar_pose(network, square, mesh)
    alignment_from_object = rigid.translation(x, y, 0.0) @ rigid.rotation((0.0, 0.0, angle_rad))
    at = rigid.invert(target.alignment_from_sensor) @ alignment_from_object
    points, pixel = _sample_contact_points(touch_depth, params)
    nearest = float(points[:, 2].min()) - float(rigid.apply(at, mesh.vertices_mm)[:, 2].min())
    progress.step(1.0, "predicted")
    return ObjectPose(
        sensor_from_object=freeze(rigid.translation(0.0, 0.0, nearest) @ at),
        scene_mm=points,
        source_index=pixel,
        notes=(NOTE,),
    )


def _predict_planar_pose(
    network: nn.Module, square: Floats, mesh: Mesh
) -> tuple[float, float, float]:
    """(x mm, y mm, rotation rad) of the object origin in the alignment frame."""
    import torch

    net = cast("Any", network)
    label = _find_label(mesh)
    names = shapes.list_labelled_shapes()
    one_hot = torch.zeros(1, net.n_objects)
    if label is not None and label < net.n_objects:
        one_hot[0, label] = 1.0
    with reproducible_inference():
        prediction = net(torch.from_numpy(np.array(square)[None]), one_hot)
    label = int(prediction.object_logits[0].argmax()) if label is None else label
    (x, y), headings = prediction.translation_mm[0].tolist(), prediction.headings[0].tolist()
    fold = max(1, shapes.make_shape(names[label]).symmetry.fold)
    multiple = fold if fold <= len(headings) else 1
    cosine, sine = headings[multiple - 1]
    return x, y, math.atan2(sine, cosine) / multiple


def _find_label(mesh: Mesh) -> int | None:
    """Class of the trained object with the same vertices; None if there is none."""
    for label, name in enumerate(shapes.list_labelled_shapes()):
        vertices_mm = shapes.make_shape(name).mesh.vertices_mm
        if vertices_mm.shape == mesh.vertices_mm.shape and np.allclose(
            vertices_mm, mesh.vertices_mm, atol=_SAME_MM
        ):
            return label
    return None


def _sample_contact_points(touch_depth: DepthMap, params: PoseParams) -> tuple[Floats, Indices]:
    """Contact points (n, 3) in mm and their pixels, at most `max_points`."""
    usable = np.flatnonzero(touch_depth.contact & np.isfinite(touch_depth.depth_mm)).astype(
        np.int32
    )
    chosen = usable[:: max(1, math.ceil(len(usable) / params.max_points))]
    points: Doubles = touch_depth.camera.back_project(touch_depth.depth_mm).reshape(-1, 3)[chosen]
    return freeze(points.astype(np.float32)), freeze(chosen)


def _register(
    touch: GeneratedTouch,  # noqa: ARG001 - an input of the replaced method
    touch_depth: DepthMap,
    target: SensorSpec,  # noqa: ARG001 - as above
    mesh: Mesh | None,
    params: PoseParams,
    progress: Progress = SILENT,
) -> ObjectPose | Skipped:
    skipped = signed_distances.skip_without_contact(touch_depth, mesh)
    if skipped is not None:
        return Skipped(output=skipped, reason=skipped.notes[0])
    return signed_distances.estimate_pose(touch_depth, mesh, params, progress)


REGISTRATION_OF_TOUCH = Method(
    stage="pose",
    name="registration_of_touch",
    title="Mesh fit",
    run=_register,
    params=PoseParams,
    reads=READS,
)
"""Fallback of the network without weights; not in the catalogue."""
