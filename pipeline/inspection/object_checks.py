"""Checks of a recording's object: size and closedness of its mesh, and distance from the contact."""

import numpy as np

from pipeline.geometry import rigid
from pipeline.geometry.meshes import LARGEST_MM, SMALLEST_MM, Mesh
from pipeline.inspection.stream_checks import Check
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import Truth


def check_mesh(mesh: Mesh, path: str) -> list[Check]:
    """Checks of size, closedness and orientation of the mesh of the recording at `path`."""
    return [_check_size(mesh, path), _check_surface(mesh, path)]


def measure_contact_offset_mm(truth: Truth, sensor: SensorSpec, mesh: Mesh) -> float:
    """Distance in mm from the median contact point to the bounding box of the object at its true pose; 0 = inside.

    Also 0 where the truth has no contact or pose, or another image size.
    """
    indentation, contact, pose = truth.indentation_mm, truth.contact, truth.sensor_from_object
    if indentation is None or contact is None or pose is None or indentation.shape != sensor.camera.shape:
        return 0.0
    points = sensor.camera.back_project(sensor.rest_depth_mm - indentation)[contact & np.isfinite(indentation)]
    if not len(points):
        return 0.0
    centre = rigid.apply(rigid.invert(pose), np.median(points.astype(np.float64), axis=0))
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    return float(np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0)))


def _check_size(mesh: Mesh, path: str) -> Check:
    corners = mesh.vertices_mm[mesh.triangles].reshape(-1, 3)
    extent = corners.max(axis=0) - corners.min(axis=0)
    text = f"{' x '.join(f'{e:.3g}' for e in extent)} mm, {len(mesh.triangles)} triangles"
    if not SMALLEST_MM <= extent.max() <= LARGEST_MM:
        text = f"the mesh is {text}; objects measure {SMALLEST_MM:g} to {LARGEST_MM:g} mm: '{path}'"
        return Check(name="object size", state="fail", text=text)
    return Check(name="object size", state="pass", text=text)


def _check_surface(mesh: Mesh, path: str) -> Check:
    """Each edge must occur once in each direction; then no part is open, doubled or flipped."""
    t = mesh.triangles.astype(np.int64)
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    n = len(mesh.vertices_mm)
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    n_open = int((~np.isin(forward, backward)).sum())
    n_doubled = len(forward) - len(np.unique(forward))
    a, b, c = (mesh.vertices_mm[t[:, k]] for k in range(3))
    volume_mm3 = float((a * np.cross(b, c)).sum()) / 6.0
    problem = ""
    if n_open:
        problem = f"{n_open} of its edges have no neighbour: it has holes and no inside"
    elif n_doubled:
        problem = f"{n_doubled} of its edges occur twice in one direction: triangles are doubled or flipped"
    elif volume_mm3 <= 0:
        problem = f"its triangles face inward (volume {volume_mm3:.3g} mm³); flip them"
    if problem:
        return Check(name="object surface", state="fail", text=f"the mesh: {problem}: '{path}'")
    return Check(name="object surface", state="pass", text=f"closed and facing outward, {volume_mm3:.3g} mm³")
