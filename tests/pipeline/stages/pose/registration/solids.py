"""Solids whose depth along a ray is known exactly, and what a flat gel would feel of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.results import DepthMap
from pipeline.physics.simulation.shapes.solids import revolve_profile

# 0.11 mm/px on the gel
CAMERA = Camera(rows=120, cols=160, fx_px=178.0, fy_px=178.0, cx_px=79.5, cy_px=59.5)
REST_MM = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Solid:
    """A union of convex pieces, each a list of planes (m, 4) with n . p <= d inside, and its
    triangle mesh.
    """

    pieces: tuple[np.ndarray, ...]
    mesh: Mesh


def extruded(outline, convex_parts, low_mm, high_mm, axes=(0, 1, 2)) -> Solid:
    """A prism: `outline` (anticlockwise, (n, 2)) and its convex parts, along the third of
    `axes`.
    """
    outline = np.asarray(outline, float)
    parts = [np.asarray(p, float) for p in convex_parts]

    def lifted(points, height):
        out = np.empty((len(points), 3))
        out[:, axes[0]], out[:, axes[1]], out[:, axes[2]] = points[:, 0], points[:, 1], height
        return out

    corners = []
    for k in range(len(outline)):
        edge = outline[[k, (k + 1) % len(outline)]]
        (a, b), (c, d) = lifted(edge, low_mm), lifted(edge, high_mm)
        corners += [(a, b, d), (a, d, c)]
    for part in parts:
        bottom = lifted(part, low_mm)
        top = lifted(part, high_mm)
        for k in range(1, len(part) - 1):
            corners += [(top[0], top[k], top[k + 1]), (bottom[0], bottom[k + 1], bottom[k])]
    if np.linalg.det(np.eye(3)[list(axes)]) < 0:
        corners = [(a, c, b) for a, b, c in corners]
    vertices = np.array(corners).reshape(-1, 3)
    planes = tuple(_planes(p, low_mm, high_mm, axes) for p in parts)
    return Solid(
        pieces=planes,
        mesh=Mesh(
            vertices_mm=vertices, triangles=np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        ),
    )


def _planes(part, low_mm, high_mm, axes):
    rows = []
    for k in range(len(part)):
        a = part[k]
        b = part[(k + 1) % len(part)]
        n = np.array([b[1] - a[1], a[0] - b[0]]) / np.linalg.norm(b - a)
        plane = np.zeros(4)
        plane[axes[0]], plane[axes[1]], plane[3] = n[0], n[1], n @ a
        rows.append(plane)
    for sign, d in ((1.0, high_mm), (-1.0, -low_mm)):
        plane = np.zeros(4)
        plane[axes[2]] = sign
        plane[3] = d
        rows.append(plane)
    return np.array(rows)


def observe_depth(
    solid: Solid, sensor_from_object: np.ndarray, camera: Camera = CAMERA, noise_mm: float = 0.0
) -> DepthMap:
    """The touch of a gel that follows the solid wherever they overlap.

    Exact but for float32 and `noise_mm`.
    """
    x, y = camera.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(camera.shape)], axis=-1)
    inverse = rigid.invert(sensor_from_object)
    origin = inverse[:3, 3]
    direction = ray @ inverse[:3, :3].T
    depth = np.full(camera.shape, np.inf)
    for piece in solid.pieces:
        along = direction @ piece[:, :3].T
        room = piece[:, 3] - piece[:, :3] @ origin
        with np.errstate(divide="ignore", invalid="ignore"):
            t = room / along
        enter = np.where(along < 0, t, -np.inf).max(axis=-1)
        leave = np.where(along > 0, t, np.inf).min(axis=-1)
        outside = ((along == 0) & (room < 0)).any(axis=-1)
        depth = np.where((enter < leave) & (enter > 0) & ~outside, np.minimum(depth, enter), depth)
    contact = depth < REST_MM
    surface = np.minimum(depth, REST_MM)
    surface = surface + noise_mm * np.random.default_rng(1).standard_normal(camera.shape)
    return touch_of(surface, contact, camera)


def touch_of(surface_mm: np.ndarray, contact: np.ndarray, camera: Camera = CAMERA) -> DepthMap:
    """The depth map of this membrane and contact."""
    return DepthMap(
        indentation_mm=np.float32(REST_MM - surface_mm),
        depth_mm=surface_mm.astype(np.float32),
        contact=contact,
        camera=camera,
        source_index=np.arange(contact.size, dtype=np.int32).reshape(contact.shape),
        in_view=np.ones(contact.shape, bool),
    )


def l_bar() -> Solid:
    """An L of 12 x 9 mm arms, 3 mm wide and 4 mm high, with its flat side along z."""
    return extruded(
        [(0, 0), (12, 0), (12, 3), (3, 3), (3, 9), (0, 9)],
        [[(0, 0), (12, 0), (12, 3), (0, 3)], [(0, 3), (3, 3), (3, 9), (0, 9)]],
        0.0,
        4.0,
    )


def notched_wedge() -> Solid:
    """A roof 10 mm long along y, with a ridge along y that a notch interrupts, sides of 25 and
    40 degrees.
    """
    a = np.tan(np.deg2rad(25))
    b = np.tan(np.deg2rad(40))
    left = -2.0 / a
    right = 2.0 / b
    roof = [(left, 0.0), (right, 0.0), (0.0, 2.0)]
    low = [(left, 0.0), (right, 0.0), (right * 0.6, 0.8), (left * 0.6, 0.8)]
    ends = [
        extruded(p, [p], y0, y1, axes=(0, 2, 1))
        for p, y0, y1 in ((roof, -5, -1), (low, -1, 1), (roof, 1, 6))
    ]
    vertices = np.concatenate([s.mesh.vertices_mm for s in ends])
    return Solid(
        pieces=tuple(p for s in ends for p in s.pieces),
        mesh=Mesh(
            vertices_mm=vertices, triangles=np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        ),
    )


def rod(radius_mm: float = 3.0, length_mm: float = 60.0, sides: int = 64) -> Solid:
    """A long prism of many sides along x."""
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return extruded(ring, [ring], -length_mm / 2, length_mm / 2, axes=(1, 2, 0))


def slab(half_mm: float = 20.0) -> Solid:
    """A plate larger than the window."""
    square = [(-half_mm, -half_mm), (half_mm, -half_mm), (half_mm, half_mm), (-half_mm, half_mm)]
    return extruded(square, [square], 0.0, 5.0)


def pressed(rotation_deg, x_mm: float, y_mm: float, outermost_mm: float) -> np.ndarray:
    """sensor_from_object: turned by a rotation vector, then moved so that its origin is at (x,
    y, outermost).
    """
    return rigid.from_parts([x_mm, y_mm, outermost_mm], rotation_deg)


def ball(radius_mm: float, sides: int = 128) -> Mesh:
    """A closed ball about the origin, its triangles within 0.1 % of the radius of it."""
    angle = np.linspace(0.0, np.pi, sides // 2 + 1)
    return revolve_profile(
        radius_mm * np.stack([np.sin(angle), -np.cos(angle)], axis=-1), sides, "ball"
    )
