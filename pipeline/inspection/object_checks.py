"""The checks of a recording's object: whether its mesh can be felt, has an inside, and lies where it is touched."""

from __future__ import annotations

import numpy as np

from pipeline.geometry import rigid
from pipeline.geometry.meshes import LARGEST_MM, SMALLEST_MM, Mesh
from pipeline.inspection.stream_checks import Check
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import Truth


def check_mesh(mesh: Mesh, path: str) -> list[Check]:
    """Size, closedness and orientation of `mesh`, which the recording at `path` brings."""
    return [_size(mesh, path), _surface(mesh, path)]


def measure_contact_offset_mm(truth: Truth, sensor: SensorSpec, mesh: Mesh) -> float:
    """How far the middle of what is touched lies outside the box of the object as it is said to lie; 0 = inside.

    Also 0 where the truth does not say where it is touched, or is of another image size.
    """
    moved, touched, pose = truth.indentation_mm, truth.contact, truth.sensor_from_object
    if moved is None or touched is None or pose is None or moved.shape != sensor.camera.shape:
        return 0.0
    points = sensor.camera.back_project(sensor.rest_depth_mm - moved)[touched & np.isfinite(moved)]
    if not len(points):
        return 0.0
    middle = rigid.apply(rigid.invert(pose), np.median(points.astype(np.float64), axis=0))
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    return float(np.linalg.norm(np.maximum(np.maximum(low - middle, middle - high), 0.0)))


def _size(mesh: Mesh, path: str) -> Check:
    corners = mesh.vertices_mm[mesh.triangles].reshape(-1, 3)
    extent = corners.max(axis=0) - corners.min(axis=0)
    text = f"{' x '.join(f'{e:.3g}' for e in extent)} mm, {len(mesh.triangles)} triangles"
    if not SMALLEST_MM <= extent.max() <= LARGEST_MM:
        text = f"the mesh is {text}; what is touched measures {SMALLEST_MM:g} to {LARGEST_MM:g} mm: '{path}'"
        return Check(name="object size", state="fail", text=text)
    return Check(name="object size", state="pass", text=text)


def _surface(mesh: Mesh, path: str) -> Check:
    """Every edge must be walked once each way: then nothing is open, doubled or turned against its neighbour."""
    t = mesh.triangles.astype(np.int64)
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    n = len(mesh.vertices_mm)
    there, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    alone = int((~np.isin(there, back)).sum())
    twice = len(there) - len(np.unique(there))
    a, b, c = (mesh.vertices_mm[t[:, k]] for k in range(3))
    volume_mm3 = float((a * np.cross(b, c)).sum()) / 6.0
    bad = ""
    if alone:
        bad = f"{alone} of its edges have no neighbour: there are holes, and no inside to measure from"
    elif twice:
        bad = f"{twice} of its edges are walked twice the same way: triangles lie double or are turned"
    elif volume_mm3 <= 0:
        bad = f"its triangles face inward (volume {volume_mm3:.3g} mm³); turn them round"
    if bad:
        return Check(name="object surface", state="fail", text=f"the mesh: {bad}: '{path}'")
    return Check(name="object surface", state="pass", text=f"closed and facing outward, {volume_mm3:.3g} mm³")
