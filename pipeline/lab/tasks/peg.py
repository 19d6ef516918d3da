"""A peg and its hole as convex pieces: the tip of a tool, and walls around the tip's outline
with a clearance.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.errors import MeshProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.lab.tasks.scene import write_box
from pipeline.lab.tasks.scene_bodies import list_angles, make_ring

_MARGIN_MM = 1.0  # of the peg beyond what is inserted
_MAX_WALLS = 16  # a rounder outline gets this many walls
_STRAIGHT = 1e-6  # squared sine of two outline edges that are one
_WALL_MM = 20.0  # thickness and half length of walls
# the plate on display: width around and height below the hole
_PLATE_MM = 10.0
_BELOW_MM = 2.0
_PLATE_SIDES = 96


@dataclass(frozen=True, slots=True, kw_only=True)
class Peg:
    """The part of a tool that is inserted along +x."""

    points_mm: Doubles  # (n, 3) corners of its convex hull in the tool frame
    tip_mm: float  # x of the tip
    depth_mm: float  # full depth
    directions: Doubles  # (k, 2) outward normals of the hole's walls in the tool's y and z
    reach_mm: Doubles  # (k,) how far the peg reaches along each


def cut_peg(mesh: Mesh, depth_mm: float) -> Peg:
    """The peg at the +x end of a tool; raises MeshProblem for a tool shorter than the depth."""
    x = mesh.vertices_mm[:, 0]
    tip = float(x.max())
    start = float(x.max()) - depth_mm - _MARGIN_MM
    if start < x.min():
        raise MeshProblem(
            f"the tool {mesh.name!r} is {np.ptp(x):.3g} mm long along x, too short for "
            f"{depth_mm:g} mm"
        )
    a, b = (mesh.vertices_mm[mesh.triangles[:, k]].reshape(-1, 3) for k in ((0, 1, 2), (1, 2, 0)))
    crosses = (a[:, 0] < start) != (b[:, 0] < start)
    a = a[crosses]
    b = b[crosses]
    cut = a + ((start - a[:, 0]) / (b[:, 0] - a[:, 0]))[:, None] * (b - a)
    points = np.concatenate([mesh.vertices_mm[x >= start], cut])
    hull = _hull_vertices(points)
    inserted = points[points[:, 0] >= start + _MARGIN_MM - 1e-9, 1:]
    directions = _list_walls(inserted if len(inserted) > 2 else points[:, 1:])
    return Peg(
        points_mm=hull,
        tip_mm=tip,
        depth_mm=depth_mm,
        directions=directions,
        reach_mm=(hull[:, 1:] @ directions.T).max(axis=0),
    )


def write_hole(peg: Peg, clearance_mm: float, lead_in_mm: float) -> str:
    """MJCF of a plate at z <= 0 with the peg's hole: wider by `clearance_mm` in all, with a 45
    degree lead-in.

    The tool's x points down, its y along -x and its z along +y of the world.
    """
    pieces: list[str] = []
    for (u, v), reach in zip(peg.directions, peg.reach_mm, strict=True):
        heading = math.atan2(v, -u)
        wall = rigid.rotation((0.0, 0.0, heading)) @ rigid.translation(
            reach + 0.5 * clearance_mm, 0.0, 0.0
        )
        half_height = 0.5 * (peg.depth_mm + 10.0)
        middle = rigid.translation(0.5 * _WALL_MM, 0.0, -lead_in_mm - half_height)
        pieces.append(
            write_box((0.5 * _WALL_MM, _WALL_MM, half_height), wall @ middle, 'friction="0.3"')
        )
        if lead_in_mm > 0:  # a slab whose upper face rises by 45 degrees from the wall's upper edge
            slope = rigid.translation(0.0, 0.0, -lead_in_mm) @ rigid.rotation(
                (0.0, -0.25 * math.pi, 0.0)
            )
            half = 0.5 * math.sqrt(2.0) * lead_in_mm
            slab = wall @ slope @ rigid.translation(half, 0.0, -2.0)
            pieces.append(write_box((half, _WALL_MM, 2.0), slab, 'friction="0.3"'))
            top = rigid.translation(lead_in_mm + 0.5 * _WALL_MM, 0.0, -2.0)
            pieces.append(
                write_box((0.5 * _WALL_MM, 2.0 * _WALL_MM, 2.0), wall @ top, 'friction="0.3"')
            )
    return f'<body name="plate">{"".join(pieces)}</body>'


def make_hole_mesh(peg: Peg, clearance_mm: float, lead_in_mm: float) -> Mesh:
    """A round plate with the hole of `write_hole`, for the 3D scene."""
    angles = list_angles(_PLATE_SIDES)
    # the tool's y and z in the world
    along = np.column_stack([-np.cos(angles), np.sin(angles)]) @ peg.directions.T
    reach = peg.reach_mm + 0.5 * clearance_mm
    hole = np.where(along > _STRAIGHT, reach / np.maximum(along, _STRAIGHT), np.inf).min(axis=1)
    outside = np.full_like(hole, hole.max() + _PLATE_MM)
    deep_mm = peg.depth_mm + _BELOW_MM
    profile = (
        (outside, 0.0),
        (hole + lead_in_mm, 0.0),
        (hole, -lead_in_mm),
        (hole, -deep_mm),
        (outside, -deep_mm),
    )
    return make_ring(profile, angles, "hole")


def _hull_vertices(points: Doubles) -> Doubles:
    from scipy.spatial import ConvexHull

    return points[np.sort(ConvexHull(points).vertices)]


def _list_walls(outline_mm: Doubles) -> Doubles:
    """Outward normals (k, 2) of an outline's convex hull.

    Evenly spread ones for a round outline.
    """
    from scipy.spatial import ConvexHull

    normals = ConvexHull(outline_mm).equations[:, :2]
    kept: list[Doubles] = []
    for normal in normals:
        if all(1.0 - float(normal @ other) > _STRAIGHT for other in kept):
            kept.append(normal)
    if len(kept) <= _MAX_WALLS:
        return np.array(kept)
    angle = 2.0 * math.pi * np.arange(_MAX_WALLS) / _MAX_WALLS
    return np.column_stack([np.cos(angle), np.sin(angle)])
