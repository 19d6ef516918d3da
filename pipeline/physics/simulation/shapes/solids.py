"""Closed bodies: prisms over an outline, and rings of points stacked with lids, revolved, or swept
along a path.

Triangles run counter-clockwise seen from outside.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import MeshProblem, SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh, load_mesh
from pipeline.core.geometry.symmetry import Symmetry, asymmetric
from pipeline.physics.simulation.shapes.polygons import (
    Outline,
    compute_arc_step_rad,
    inset_polygon,
    make_arc,
    orient_counter_clockwise,
    triangulate_polygon,
)


@frozen
class Shape:
    """Mesh and symmetry of an object; simulation and registration use the same mesh."""

    mesh: Mesh  # object frame: z away from the sensor, tactile face at the lowest z
    symmetry: Symmetry


Face = tuple[int, int, int]
_POLE_MM = 1e-9  # a ring narrower than this is a point


def make_mesh(vertices_mm: Doubles, faces: Sequence[Face], name: str) -> Mesh:
    """The mesh of these vertices (n, 3) and faces."""
    return Mesh(
        vertices_mm=freeze(vertices_mm),
        triangles=freeze(np.array(faces, dtype=np.int32)),
        name=name,
    )


def make_wall_faces(n_rings: int, n: int, *, endless: bool = False) -> list[Face]:
    """Faces between rings of `n` vertices, ring after ring.

    Each runs counter-clockwise seen from the last ring.

    `endless` joins the last ring to the first.
    """
    faces: list[Face] = []
    for ring in range(n_rings if endless else n_rings - 1):
        low = ring * n
        high = (ring + 1) % n_rings * n
        for k in range(n):
            after = (k + 1) % n
            faces += [(low + k, low + after, high + after), (low + k, high + after, high + k)]
    return faces


def loft(
    rings_mm: Doubles, name: str, *, first_mm: Doubles | None = None, last_mm: Doubles | None = None
) -> Mesh:
    """A body over rings (k, n, 3) with star-shaped ends.

    `first_mm` and `last_mm` are tips, by default their centres.

    The rings run counter-clockwise seen from the last one.
    """
    k, n, _ = rings_mm.shape
    first = rings_mm[0].mean(axis=0) if first_mm is None else first_mm
    last = rings_mm[-1].mean(axis=0) if last_mm is None else last_mm
    faces = make_wall_faces(k, n)
    top = (k - 1) * n
    for i in range(n):
        after = (i + 1) % n
        faces += [(k * n, after, i), (k * n + 1, top + i, top + after)]
    return make_mesh(
        np.concatenate([rings_mm.reshape(-1, 3), first[None], last[None]]), faces, name
    )


def revolve_profile(profile_mm: Doubles, n_sides: int, name: str) -> Mesh:
    """A body of revolution about z from a profile (n, 2) of radius and z, from the tactile end up.

    A profile that starts or ends at radius 0 ends in a tip there, any other in a flat disc.
    """
    angle = 2.0 * math.pi * np.arange(n_sides) / n_sides
    ends = [np.array([0.0, 0.0, profile_mm[end, 1]]) for end in (0, -1)]
    wide = profile_mm[profile_mm[:, 0] > _POLE_MM]
    around = np.column_stack([np.cos(angle), np.sin(angle), np.ones(n_sides)])
    rings = around[None] * wide[:, None, [0, 0, 1]]
    return loft(rings, name, first_mm=ends[0], last_mm=ends[1])


def count_circle_sides(radius_mm: float) -> int:
    """Number of sides of a circle within `CHORD_MM`, a multiple of four so that it is as wide as
    high.
    """
    return 4 * math.ceil(math.pi / (2.0 * compute_arc_step_rad(radius_mm)))


def sweep_section(
    path_mm: Doubles, section_mm: Doubles, name: str, *, endless: bool = False
) -> Mesh:
    """A section (m, 2) of offset to the left and z, swept along a plane path (n, 2), corners
    mitred.

    The section runs counter-clockwise. An endless path returns to its start and has no ends; others
    are cut square. Raises MeshProblem when the section is wider than the path's bends allow.
    """
    along = np.roll(path_mm, -1, axis=0) - path_mm
    if not endless:
        along[-1] = along[-2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.column_stack([-along[:, 1], along[:, 0]])
    before = np.roll(left, 1, axis=0)
    if not endless:
        before[0] = left[0]
    mitre = (left + before) / (1.0 + (left * before).sum(axis=1, keepdims=True))
    plane = path_mm[:, None] + section_mm[None, :, :1] * mitre[:, None]  # (n, m, 2)
    forward = (np.roll(plane, -1, axis=0) - plane) @ along[:, :, None]
    if (forward[: None if endless else -1] <= 0).any():
        raise MeshProblem(f"the section of {name!r} is wider than the bends of its path allow")
    rings = np.concatenate(
        [plane, np.broadcast_to(section_mm[None, :, 1:], (*plane.shape[:2], 1))], axis=2
    )
    k, n = rings.shape[:2]
    faces = make_wall_faces(k, n, endless=endless)
    if not endless:
        faces += _make_lids(section_mm, section_mm, (k - 1) * n)
    return make_mesh(rings.reshape(-1, 3), faces, name)


def transform_mesh(mesh: Mesh, object_from_mesh: Doubles) -> Mesh:
    """The mesh with `object_from_mesh` (4, 4) applied."""
    return replace(mesh, vertices_mm=freeze(rigid.apply(object_from_mesh, mesh.vertices_mm)))


FACES = ("-x", "+x", "-y", "+y", "-z", "+z")  # of a mesh that may touch


def load_mesh_shape(path: Path, unit: str = "auto", face: str = "-z") -> Shape:
    """A shape from an STL, PLY or OBJ file, its tactile side toward `face`, such as "+x"; without
    symmetry.

    That side is rotated to -z, and the mesh centred over the origin with its lowest point at z = 0.
    Raises SettingProblem for an unknown face, FileProblem or MeshProblem for what `load_mesh`
    refuses.
    """
    if face not in FACES:
        raise SettingProblem(f"the tactile face must be one of {', '.join(FACES)}, got {face!r}")
    mesh = transform_mesh(load_mesh(Path(path), unit), _rotate_down(face))
    low = mesh.vertices_mm.min(axis=0)
    x, y = -0.5 * (low + mesh.vertices_mm.max(axis=0))[:2]
    mesh = transform_mesh(mesh, rigid.translation(x, y, -low[2]))
    return Shape(mesh=mesh, symmetry=asymmetric())


def _rotate_down(face: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The rotation (4, 4) that takes an axis to -z."""
    axis = "xyz".index(face[1])
    up = (-1.0 if face[0] == "+" else 1.0) * np.eye(3)[axis]
    side = np.eye(3)[(axis + 1) % 3]
    turn = np.eye(4)
    # rows are x, y, z; right-handed: x = y cross z
    turn[:3, :3] = np.stack([np.cross(side, up), side, up])
    return turn


def make_chamfered_prism(
    outline_mm: Outline | Doubles, height_mm: float, chamfer_mm: float, name: str
) -> Mesh:
    """A prism over a simple polygon, its tactile face chamfered by 45 degrees.

    Raises MeshProblem when the outline crosses itself or the chamfer is wider than the polygon.
    """
    outer = orient_counter_clockwise(outline_mm)
    rings = ((inset_polygon(outer, chamfer_mm), 0.0), (outer, chamfer_mm), (outer, height_mm))
    return stack_rings([lift_outline(*ring) for ring in rings], name)


def make_rounded_prism(
    outline_mm: Outline | Doubles, height_mm: float, radius_mm: float, name: str
) -> Mesh:
    """A prism over a simple polygon, its tactile face rounded by a quarter circle.

    Raises MeshProblem when the outline crosses itself or the rounding is wider than the polygon.
    """
    outer = orient_counter_clockwise(outline_mm)
    return stack_rings(
        [*make_rounded_rings(outer, radius_mm), lift_outline(outer, height_mm)], name
    )


def stack_rings(rings_mm: Sequence[Doubles], name: str) -> Mesh:
    """A body over level outlines (n, 3) from the tactile face up, counter-clockwise, with equal
    numbers of points.
    """
    k = len(rings_mm)
    n = len(rings_mm[0])
    # the tactile face looks to -z
    faces = _make_lids(rings_mm[0][:, :2], rings_mm[-1][:, :2], (k - 1) * n)
    return make_mesh(np.concatenate(rings_mm), [*faces, *make_wall_faces(k, n)], name)


def _make_lids(first_mm: Doubles, last_mm: Doubles, begin: int) -> list[Face]:
    """Faces of the first ring (n, 2) backwards, and of the last one from this vertex on."""
    first = [(c, b, a) for a, b, c in triangulate_polygon(first_mm)]
    last = triangulate_polygon(last_mm)
    return [*first, *((a + begin, b + begin, c + begin) for a, b, c in last)]


def lift_outline(outline_mm: Doubles, z_mm: float) -> Doubles:
    """An outline (n, 2) at a height; (n, 3)."""
    return np.column_stack([outline_mm, np.full(len(outline_mm), z_mm)])


def make_rounded_rings(outline_mm: Doubles, radius_mm: float) -> list[Doubles]:
    """Level outlines (n, 3) of a tactile face rounded by a quarter circle; the last is vertical."""
    quarter = make_arc(radius_mm, -90.0, 0.0, (0.0, radius_mm))
    return [
        lift_outline(inset_polygon(outline_mm, radius_mm - float(x)), float(z)) for x, z in quarter
    ]
