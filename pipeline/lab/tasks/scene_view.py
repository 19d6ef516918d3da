"""The bodies of a recorded rollout and their poses at every tick, for 3D views, its quantities
against time, and the meshes that surround the object: boxes, rings, and the fingers of a hand.
"""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.errors import TouchError
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.lab.tasks.grasp import FINGERS, GRIP_MM, PlanarPose, press_between_fingers
from pipeline.lab.tasks.task import RecordedRollout, SceneBody, TaskScene, load_task
from pipeline.physics.simulation.shapes.solids import make_mesh, make_wall_faces
from pipeline.views.colours import Rgb, repeat_colour
from pipeline.views.layers import Layer, ViewBounds, make_lines_layer, make_mesh_layer
from pipeline.views.view import StepCurve

OBJECT_COLOUR: Rgb = (0, 114, 178)  # true pose: blue, a solid (Okabe-Ito)
ESTIMATE_COLOUR: Rgb = (213, 94, 0)  # estimated pose: vermilion, dashed edges
SURROUNDINGS_COLOUR: Rgb = (150, 156, 166)
TRUE_NAME = "true pose"
ESTIMATE_NAME = "estimated pose"
VIEW_FRAME = "world"
# of the camera in the world, from the front above
_DIRECTION = (0.45, -1.0, 0.4)
_UP = (0.0, 0.0, 1.0)
_SURROUNDINGS_OPACITY = 0.3
# length of a dash with its gap in mm, and the dash's part of it
_DASHES = 3.0
_DASH_SHARE = 0.6
_SHARP = 1.95  # length of the sum of two faces' normals up to which their common edge is drawn
_MAX_EDGES = 600
_NO_AREA_MM2 = 1e-9
_DIGITS = 6  # of vertices in mm that are one place; of a curve: rounding is no motion
_MARGIN = 0.6  # radius of the view over the diagonal of the object's way


@frozen
class RolloutScene:
    """Bodies of one rollout; `place` says where they are at a tick."""

    rollout: RecordedRollout
    mesh: Mesh  # of the object
    bodies: tuple[SceneBody, ...]  # around it
    hand_from_estimates: tuple[Doubles, ...]  # (4, 4) mm of each decision; () = not known
    problem: str = ""  # why nothing is around the object

    def place(self, tick: int) -> dict[str, Doubles]:
        """world_from_body (4, 4) of every body by name, the object's true and estimated pose
        among them.
        """
        run = self.rollout
        parents = {
            "world": np.eye(4),
            "object": run.world_from_object[tick],
            "hand": run.world_from_hand[tick],
        }
        parents |= {name: poses[tick] for name, poses in run.world_from_bodies.items()}
        placed = {
            body.name: parents[body.parent] @ body.parent_from_body
            for body in self.bodies
            if body.parent in parents
        }
        placed[TRUE_NAME] = run.world_from_object[tick]
        if self.hand_from_estimates:
            placed[ESTIMATE_NAME] = (
                run.world_from_hand[tick] @ self.hand_from_estimates[run.find_decision(tick)]
            )
        return placed


def build_scene(rollout: RecordedRollout) -> RolloutScene:
    """The scene of a rollout; the object alone where its task or its case is not known here."""
    scene = TaskScene(bodies=())
    estimates: tuple[Doubles, ...] = ()
    problem = ""
    try:
        build = load_task(rollout.plan.task).build_scene
        made = scene if build is None else build(rollout)
        if made.hand_from_estimate is not None:
            estimates = tuple(map(made.hand_from_estimate, rollout.summary.decisions))
        scene = made
    except TouchError as error:
        problem = str(error)
    return RolloutScene(
        rollout=rollout,
        mesh=scene.object_mesh or rollout.mesh or _POINT,
        bodies=scene.bodies,
        hand_from_estimates=estimates,
        problem=problem,
    )


def make_scene_layers(scene: RolloutScene) -> tuple[Layer, ...]:
    """One layer per body, each in its own frame: `RolloutScene.place` moves them."""
    layers = [make_mesh_layer(TRUE_NAME, scene.mesh, OBJECT_COLOUR)]
    if scene.hand_from_estimates:
        dashes = cut_dashes(find_edges(scene.mesh))
        layers.append(
            make_lines_layer(ESTIMATE_NAME, dashes, repeat_colour(ESTIMATE_COLOUR, len(dashes)))
        )
    layers += [
        make_mesh_layer(body.name, body.mesh, SURROUNDINGS_COLOUR, opacity=_SURROUNDINGS_OPACITY)
        for body in scene.bodies
    ]
    return tuple(layers)


def compute_bounds(scene: RolloutScene) -> ViewBounds:
    """The view of the whole way of the object, from the front above."""
    ways = scene.rollout.world_from_object[:: max(1, scene.rollout.n_ticks // 8)]
    corners = np.array([scene.mesh.vertices_mm.min(axis=0), scene.mesh.vertices_mm.max(axis=0)])
    reached = np.concatenate(
        [rigid.apply(pose, corners) for pose in (*ways, scene.rollout.world_from_object[-1])]
    )
    low = reached.min(axis=0)
    high = reached.max(axis=0)
    x, y, z = (0.5 * (low + high)).tolist()
    return ViewBounds(
        centre_mm=(x, y, z),
        radius_mm=_MARGIN * float(np.linalg.norm(high - low)),
        frame=VIEW_FRAME,
        direction=_DIRECTION,
        up=_UP,
    )


def find_edges(mesh: Mesh) -> Floats:
    """Sharp edges (n, 2, 3) of a mesh in mm; of a smooth mesh some of all its edges."""
    corners = mesh.vertices_mm[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    has_area = area > _NO_AREA_MM2
    normals = normals[has_area] / area[has_area, None]
    places, place_of_vertex = np.unique(
        mesh.vertices_mm.round(_DIGITS), axis=0, return_inverse=True
    )
    sides = mesh.triangles[has_area][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    unique, of_edge, counts = np.unique(
        np.sort(place_of_vertex.ravel()[sides], axis=1),
        axis=0,
        return_inverse=True,
        return_counts=True,
    )
    # two unit normals add up to 2 on one plane
    sums = np.zeros((len(unique), 3))
    np.add.at(sums, of_edge.ravel(), np.repeat(normals, 3, axis=0))
    chosen = unique[(counts != 2) | (np.linalg.norm(sums, axis=1) < _SHARP)]
    if len(chosen) < 6:
        chosen = unique
    chosen = chosen[:: max(1, len(chosen) // _MAX_EDGES)]
    return freeze(places[chosen].astype(np.float32))


def cut_dashes(ends_mm: Floats) -> Floats:
    """Lines (n, 2, 3) cut into dashes (m, 2, 3) of equal length."""
    dashes: list[Floats] = []
    for begin, end in ends_mm:
        n = max(1, round(float(np.linalg.norm(end - begin)) / _DASHES))
        at = np.arange(n)[:, None] / n
        stop = at + _DASH_SHARE / n
        dashes.append(np.stack([begin + at * (end - begin), begin + stop * (end - begin)], axis=1))
    return freeze(np.concatenate(dashes).astype(np.float32))


_POINT = Mesh(
    vertices_mm=freeze(np.array([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.5, 0.0)])),
    triangles=freeze(np.array([(0, 1, 2)], dtype=np.int32)),
    name="object",
)  # of a recording without a mesh


# half sizes of a finger's pad: GelSlim's sensing area and a part of its housing
_PAD_MM = (9.0, 11.0, 3.0)
_BOX_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def make_box(
    half_mm: Sequence[float], name: str, centre_mm: Sequence[float] = (0.0, 0.0, 0.0)
) -> Mesh:
    """A box of these half sizes about a centre."""
    signs = np.array(
        [[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64
    )
    triangles = [(a, b, c) for a, b, c, _ in _BOX_FACES] + [(a, c, d) for a, _, c, d in _BOX_FACES]
    return make_mesh(np.asarray(centre_mm) + signs * np.asarray(half_mm), triangles, name)


def make_ring(profile_mm: Sequence[tuple[Doubles, float]], angles_rad: Doubles, name: str) -> Mesh:
    """A closed ring about z: its profile is a sequence of radius at every angle and height."""
    around = np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    rings = [
        np.column_stack(
            [np.multiply(np.atleast_1d(radius)[:, None], around), np.full(len(around), z)]
        )
        for radius, z in profile_mm
    ]
    return make_mesh(
        np.concatenate(rings), make_wall_faces(len(rings), len(angles_rad), endless=True), name
    )


def make_fingers(
    mesh: Mesh, held: PlanarPose, hand_from_planar: Doubles | None = None
) -> tuple[SceneBody, ...]:
    """The pads of two fingers that hold an object.

    By default the task's hand is the frame of the fingers' plane.
    """
    hand_from_object = (np.eye(4) if hand_from_planar is None else hand_from_planar) @ held.matrix
    pad = make_box(_PAD_MM, "finger", (0.0, 0.0, -_PAD_MM[2]))
    return tuple(
        SceneBody(
            name=f"{finger} finger",
            mesh=pad,
            parent="hand",
            parent_from_body=freeze(
                hand_from_object @ rigid.invert(press_between_fingers(mesh, held, finger, GRIP_MM))
            ),
        )
        for finger in FINGERS
    )


def list_angles(n: int) -> Doubles:
    """`n` angles once around, in radians."""
    return 2.0 * math.pi * np.arange(n) / n


FORCE = "force"
COMMAND = "command"
MOTION = "motion"
GAP = "deviation"


def make_traces(rollout: RecordedRollout) -> tuple[StepCurve, ...]:
    """One curve per quantity, one value per tick.

    The force is the contact force on the object; command and motion are the ways of the commanded
    hand and of the hand from the first command; the deviation is between the two.
    """
    begin = rollout.commanded[0, :3, 3]
    commanded = rollout.commanded[:, :3, 3]
    moved = rollout.world_from_hand[:, :3, 3]
    values = (
        (FORCE, "N", np.linalg.norm(rollout.force_n, axis=1)),
        (COMMAND, "mm", np.linalg.norm(commanded - begin, axis=1)),
        (MOTION, "mm", np.linalg.norm(moved - begin, axis=1)),
        (GAP, "mm", np.linalg.norm(commanded - moved, axis=1)),
    )
    return tuple(
        StepCurve(name=name, unit=unit, values=tuple(one.round(_DIGITS).tolist()))
        for name, unit, one in values
    )


def describe_tick(rollout: RecordedRollout, tick: int) -> str:
    """Number, time, force and decision of a tick."""
    force_n = float(np.linalg.norm(rollout.force_n[tick]))
    text = f"tick {tick} of {rollout.n_ticks}, {rollout.time_s[tick]:.2f} s, {force_n:.1f} N"
    decisions = [k for k, decision in enumerate(rollout.summary.decisions) if decision.tick == tick]
    return text + "".join(f", decision {k}" for k in decisions)
