"""Pose of a grasped object in a hand's plane from the touches of its two fingers, near the planned
grasp.

Two parallel fingers leave an object three degrees of freedom: translation and rotation in their
plane. Each finger's touch is registered on the object's signed distances from starts over the range
of grasps; the finger that the object explains better counts more.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.results import DepthMap, ObjectPose
from pipeline.physics.simulation.poses import compute_lowest_mm
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.pose.registration.scene import InitialPose
from pipeline.stages.pose.registration.search import PoseSearch
from pipeline.stages.pose.signed_distances import PoseParams, prepare_search

FINGERS = ("left", "right")
# the right finger looks back at the left one
_FLIP: Doubles = freeze(rigid.rotation((math.pi, 0.0, 0.0)))
GRIP_MM = 0.6  # indentation that the controller expects
_OFFSETS_MM = (-5.0, -2.5, 0.0, 2.5, 5.0)  # starts over the grid of grasps
_ANGLES_DEG = tuple(range(-60, 61, 10))
# beyond these a pose is not one of the planned grasp
_MAX_ANGLE_DEG = 60.0
_MAX_OFFSET_MM = 9.0
# predicted error of a generated bubble up to which its pixels are used; a network outpaints the
# rest
_CERTAIN_MM = 0.5
# two fingers that differ by less are averaged
_AGREE_MM = 2.0
_AGREE_DEG = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarPose:
    """hand_from_object in the fingers' plane."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_rad: float = 0.0

    @property
    def matrix(self) -> Doubles:
        """As (4, 4)."""
        return rigid.translation(self.x_mm, self.y_mm, 0.0) @ rigid.rotation(
            (0.0, 0.0, self.angle_rad)
        )

    def describe(self) -> dict[str, float]:
        """Its values by name, the angle in degrees."""
        return {"x_mm": self.x_mm, "y_mm": self.y_mm, "angle_deg": math.degrees(self.angle_rad)}


def parse_planar_pose(values: Mapping[str, float]) -> PlanarPose:
    """The pose that `describe` gave these values of; raises SettingProblem where one is missing."""
    try:
        x_mm, y_mm, angle_deg = (values[name] for name in ("x_mm", "y_mm", "angle_deg"))
    except KeyError as error:
        raise SettingProblem(
            f"a decision of the rollout has no {error}; run the task again"
        ) from error
    return PlanarPose(x_mm=x_mm, y_mm=y_mm, angle_rad=math.radians(angle_deg))


def project_to_plane(hand_from_object: Doubles) -> PlanarPose:
    """The planar part of a pose."""
    x, y = hand_from_object[:2, 3]
    angle = math.atan2(hand_from_object[1, 0], hand_from_object[0, 0])
    return PlanarPose(x_mm=float(x), y_mm=float(y), angle_rad=angle)


def press_between_fingers(
    mesh: Mesh, grasp: PlanarPose, finger: str, indentation_mm: float
) -> Doubles:
    """Return the pose (4, 4) of a grasped object for one finger, its deepest point `indentation_mm`
    into the gel.

    The pose maps object coordinates (mm) to the finger's alignment frame: z = 0 at the gel,
    pressing towards -z.
    """
    pose = (np.eye(4) if finger == "left" else _FLIP) @ grasp.matrix
    pose[2, 3] = -indentation_mm - compute_lowest_mm(
        rigid.apply(pose, mesh.vertices_mm), mesh.triangles
    )
    return pose


@dataclass(frozen=True, slots=True, kw_only=True)
class FingerEstimate:
    """The grasp as one finger sees it."""

    pose: PlanarPose
    misfit_mm: float


def estimate_grasp(
    touches: Sequence[DepthMap | None], mesh: Mesh, sensor: SensorSpec
) -> PlanarPose | None:
    """The grasp from one touch per finger in `sensor`'s frame.

    None where no finger has a usable touch.
    """
    found = [
        _estimate_by_finger(touch, mesh, sensor, finger)
        for touch, finger in zip(touches, FINGERS, strict=True)
        if touch is not None
    ]
    known = sorted((one for one in found if one is not None), key=lambda one: one.misfit_mm)
    if not known:
        return None
    best = known[0].pose
    near = [one for one in known if _is_near(one.pose, best)]
    weights = np.array([1.0 / max(one.misfit_mm, 1e-3) ** 2 for one in near])
    values = np.array([(one.pose.x_mm, one.pose.y_mm, one.pose.angle_rad) for one in near])
    x, y, angle = (weights @ values / weights.sum()).tolist()
    return PlanarPose(x_mm=x, y_mm=y, angle_rad=angle)


def _is_near(a: PlanarPose, b: PlanarPose) -> bool:
    apart_mm = math.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm)
    return apart_mm < _AGREE_MM and abs(a.angle_rad - b.angle_rad) < math.radians(_AGREE_DEG)


def _estimate_by_finger(
    touch: DepthMap, mesh: Mesh, sensor: SensorSpec, finger: str
) -> FingerEstimate | None:
    prepared = prepare_search(_keep_certain(touch), mesh, PoseParams())
    if isinstance(prepared, ObjectPose):
        return None
    search: PoseSearch = prepared[0]
    hand_from_sensor = (np.eye(4) if finger == "left" else _FLIP) @ sensor.alignment_from_sensor
    starts: list[InitialPose] = []
    for k, angle in enumerate(_ANGLES_DEG):
        for x, y in product(_OFFSETS_MM, repeat=2):
            grasp = PlanarPose(x_mm=x, y_mm=y, angle_rad=math.radians(angle))
            in_finger = press_between_fingers(mesh, grasp, finger, GRIP_MM)
            pose = rigid.invert(sensor.alignment_from_sensor) @ in_finger
            starts.append(InitialPose(sensor_from_object=pose, group=("grasp", k)))
    minima = search.find_minima(search.find_promising(search.select_likeliest(starts)))
    for minimum in minima:
        pose = project_to_plane(hand_from_sensor @ minimum.fit.sensor_from_object)
        is_planned = max(abs(pose.x_mm), abs(pose.y_mm)) <= _MAX_OFFSET_MM
        if is_planned and abs(pose.angle_rad) <= math.radians(_MAX_ANGLE_DEG):
            return FingerEstimate(pose=pose, misfit_mm=minimum.misfit_mm)
    return None


def _keep_certain(touch: DepthMap) -> DepthMap:
    """A generated touch where its predicted error is within the limit, or the better half of its
    contact.
    """
    if touch.expected_error_mm is None or not touch.is_generated or not touch.contact.any():
        return touch
    limit_mm = max(_CERTAIN_MM, float(np.nanmedian(touch.expected_error_mm[touch.contact])))
    known = np.nan_to_num(touch.expected_error_mm, nan=np.inf) <= limit_mm
    in_view = known if touch.in_view is None else touch.in_view & known
    return replace(touch, contact=freeze(touch.contact & known), in_view=freeze(in_view))
