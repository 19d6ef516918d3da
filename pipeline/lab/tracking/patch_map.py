"""Close loops between key frames, and fuse the contacts of a track into one surface, without a
mesh.

Loops are closed by Open3D's pose graph (Choi, Zhou, Koltun 2015): its nodes are the key frames, its
edges their registrations, weighted by the inverse of their covariance. The surface is Open3D's
truncated signed distance volume of the contacts, which is where the membrane has the object's
shape. A depth stage smooths a noisy bubble's membrane at the contact's edge, in every view alike,
so views add what was measured: its noise averages out over them. A single frame's contact is too
wide here and lacks parts there, so a place stays where two fifths of the views touch it whose
membrane is there.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.results import DepthMap
from pipeline.lab.tracking.surface_registration import (
    SurfaceFit,
    measure_overlap,
    register_surfaces,
)
from pipeline.lab.tracking.tracker import KeyFrame, TrackedFrame, is_accepted

_LOOP_OVERLAP = 0.5  # key frames whose predicted overlap is larger are registered to each other
# half a pixel: the rim of whole ones is a staircase
_MIN_VOXEL_MM = 0.08
_VOXEL_PX = 0.5
_TRUNCATION_VOXELS = 4.0
# of the views at a place: leaves nearly the area of the true contact (docs/experiments.md)
_CONTACT_SHARE = 0.4
# a block's side; as many blocks as are allocated at first
_BLOCK_VOXELS = 8
_N_BLOCKS = 4000
_FARTHEST_MM = 1e3
# standard deviation of the filter on what was measured: a bubble's pixel; views average the rest
_DETAIL_MM = 0.4
_OUTLIER_MM = 1.5  # measured farther from the stage's depth: flying pixels and false matches
_EMPTY = (
    "No block is touched",
    "Tensor has shape {0}",
)  # Open3D's errors of a contact of a few pixels, and of no surface
_LEAST_STD = 1e-3  # rad and mm: bounds an edge's information


@frozen
class ContactView:
    """What one frame adds to a patch map."""

    sensor_from_start: Doubles  # (4, 4)
    camera: Camera
    depth_mm: Floats  # (rows, cols) of the membrane; 0 = no value
    contact: Mask  # (rows, cols) without its outermost pixels

    @property
    def contact_depth_mm(self) -> Floats:
        """Depth (rows, cols), 0 outside the contact."""
        return np.where(self.contact, self.depth_mm, np.float32(0.0))

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel on the contact."""
        depth_mm = self.contact_depth_mm
        return float(np.median(depth_mm[depth_mm > 0])) / self.camera.fx_px


def make_view(frame: TrackedFrame, depth: DepthMap) -> ContactView | None:
    """The view of a tracked frame; None where its pose is not measured in every direction."""
    import cv2

    if frame.sensor_from_start is None or frame.weak_directions:
        return None
    inner = cv2.erode(depth.contact.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    surface_mm = (
        depth.depth_mm
        if depth.measured_depth_mm is None
        else _restore_detail(depth, depth.measured_depth_mm)
    )
    return ContactView(
        sensor_from_start=frame.sensor_from_start,
        camera=depth.camera,
        contact=freeze(inner),
        depth_mm=freeze(np.where(np.isfinite(surface_mm), surface_mm, np.float32(0.0))),
    )


def _restore_detail(depth: DepthMap, measured_mm: Floats) -> Floats:
    """The stage's depth (rows, cols) plus the filtered difference of what was measured from it."""
    import cv2

    off = measured_mm - depth.depth_mm
    near = np.abs(off) < _OUTLIER_MM  # False where either has no value
    pixel_mm = float(np.nanmedian(depth.depth_mm)) / depth.camera.fx_px
    mean, share = (
        np.asarray(cv2.GaussianBlur(values, (0, 0), max(0.5, _DETAIL_MM / pixel_mm)), np.float32)
        for values in (np.where(near, off, np.float32(0.0)), near.astype(np.float32))
    )
    return np.asarray(depth.depth_mm + mean / np.maximum(share, np.float32(0.05)), np.float32)


def close_loops(keys: Sequence[KeyFrame]) -> tuple[tuple[KeyFrame, ...], int]:
    """The key frames with poses that agree best with all registrations between them, and the
    number of closed loops.
    """
    import open3d as o3d

    pipelines: Any = o3d.pipelines.registration
    graph: Any = pipelines.PoseGraph()
    for key in keys:
        graph.nodes.append(pipelines.PoseGraphNode(rigid.invert(key.sensor_from_start)))
    n_loops = 0
    for i, j in combinations(range(len(keys)), 2):
        one = keys[i]
        two = keys[j]
        if one.part != two.part:
            continue
        two_from_one = two.sensor_from_start @ rigid.invert(one.sensor_from_start)
        is_parent = two.parent == i
        if not is_parent and measure_overlap(one.surface, two_from_one) < _LOOP_OVERLAP:
            continue
        fit = register_surfaces(one.surface, two.surface, two_from_one)
        if fit is None or not (is_parent or is_accepted(fit)):
            continue
        n_loops += not is_parent
        graph.edges.append(
            pipelines.PoseGraphEdge(i, j, fit.current_from_key, _to_information(fit), not is_parent)
        )
    if not n_loops:
        return tuple(keys), 0
    pipelines.global_optimization(
        graph,
        pipelines.GlobalOptimizationLevenbergMarquardt(),
        pipelines.GlobalOptimizationConvergenceCriteria(),
        pipelines.GlobalOptimizationOption(
            max_correspondence_distance=0.5, edge_prune_threshold=0.25, reference_node=0
        ),
    )
    poses = [rigid.orthonormalise(rigid.invert(np.asarray(node.pose))) for node in graph.nodes]
    return tuple(
        replace(key, sensor_from_start=freeze(pose)) for key, pose in zip(keys, poses, strict=True)
    ), n_loops


def _to_information(fit: SurfaceFit) -> Doubles:
    """The information matrix (6, 6) of an edge: of rotation and translation about the frame's
    origin, as in Open3D.
    """
    about_origin = np.eye(6)  # t0 = t + c x w
    about_origin[3:, :3] = rigid.cross_matrix(fit.centre_mm)
    covariance = about_origin @ (fit.covariance + _LEAST_STD**2 * np.eye(6)) @ about_origin.T
    return np.asarray(np.linalg.inv(covariance), np.float64)


def move_to_keys(
    frames: Sequence[TrackedFrame], before: Sequence[KeyFrame], after: Sequence[KeyFrame]
) -> tuple[TrackedFrame, ...]:
    """The frames with poses that follow their key frames from `before` to `after` a closed loop."""
    moved: list[TrackedFrame] = []
    for frame in frames:
        if frame.sensor_from_start is None:
            moved.append(frame)
            continue
        from_key = frame.sensor_from_start @ rigid.invert(before[frame.key].sensor_from_start)
        moved.append(
            replace(frame, sensor_from_start=freeze(from_key @ after[frame.key].sensor_from_start))
        )
    return tuple(moved)


def fuse_views(views: Sequence[ContactView]) -> Mesh | None:
    """The surface of all views in the sensor frame of the first.

    None where they have no surface.
    """
    import open3d

    o3d: Any = open3d
    views = [view for view in views if view.contact_depth_mm.any()]
    if not views:
        return None
    voxel_mm = max(_MIN_VOXEL_MM, _VOXEL_PX * max(view.pixel_mm for view in views))
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"),
        (core.float32, core.float32),
        (1, 1),
        voxel_mm,
        _BLOCK_VOXELS,
        _N_BLOCKS,
    )
    n_fused = 0
    for view in views:
        depth = o3d.t.geometry.Image(core.Tensor(view.contact_depth_mm[:, :, None].copy()))
        camera = core.Tensor(view.camera.matrix)
        placed = core.Tensor(view.sensor_from_start)
        within = (depth, camera, placed, 1.0, _FARTHEST_MM, _TRUNCATION_VOXELS)
        blocks = _unless_empty(partial(grid.compute_unique_block_coordinates, *within))
        if blocks is not None:
            grid.integrate(blocks, *within)
            n_fused += 1
    surface = _unless_empty(partial(grid.extract_triangle_mesh, 0.0)) if n_fused else None
    if surface is None:
        return None
    vertices = surface.vertex.positions.numpy().astype(np.float64)
    share = _measure_contact_share(vertices, views, _TRUNCATION_VOXELS * voxel_mm)
    triangles = surface.triangle.indices.numpy().astype(np.int32)
    triangles = triangles[(share >= _CONTACT_SHARE)[triangles].all(axis=1)]
    if not triangles.size:
        return None
    used, corners = np.unique(triangles, return_inverse=True)
    vertices, triangles = _sort_mesh(vertices[used], corners.reshape(-1, 3).astype(np.int32))
    return Mesh(vertices_mm=freeze(vertices), triangles=freeze(triangles), name="patch")


def _measure_contact_share(
    points_mm: Doubles, views: Sequence[ContactView], near_mm: float
) -> Doubles:
    """Share (n,) of the views touching each point (n, 3), of those whose membrane is within
    `near_mm` of it.
    """
    n_there = np.zeros(len(points_mm))
    n_touching = np.zeros(len(points_mm))
    for view in views:
        points = rigid.apply(view.sensor_from_start, points_mm)
        x_px, y_px, visible = view.camera.project(points)
        col, row = (np.where(visible, np.rint(at), 0).astype(np.intp) for at in (x_px, y_px))
        there = visible & (np.abs(view.depth_mm[row, col] - points[:, 2]) < near_mm)
        n_there += there
        n_touching += there & view.contact[row, col]
    return n_touching / np.maximum(n_there, 1.0)


def _unless_empty(run: Callable[[], Any]) -> Any:
    """Return what a function of Open3D returns; None where it raises for lack of anything to do."""
    try:
        return run()
    except RuntimeError as error:
        if not any(words in str(error) for words in _EMPTY):
            raise
        return None


def _sort_mesh(
    vertices: Doubles, triangles: NDArray[np.int32]
) -> tuple[Doubles, NDArray[np.int32]]:
    """The same mesh in an order of its own: Open3D's threads return vertices in the order in
    which they end.
    """
    order = np.lexsort(vertices.T)
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    corners = place[triangles]
    first = corners.argmin(axis=1)[:, None]
    corners = np.take_along_axis(corners, (first + np.arange(3)) % 3, axis=1)
    return vertices[order], corners[np.lexsort(corners.T)]
