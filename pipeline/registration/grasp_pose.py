"""The paper's pose protocol as released: the contact points of both fingers registered in the grasp's plane.

The points of both fingers are joined in the grasp frame, whose x axis is the direction in which the fingers close, and
projected along it. Point-to-point ICP in two dimensions starts at the identity, samples 5000 points on the model and
runs for 200 iterations. The rotation about x is compared as the first Euler angle, without wrapping. The released code
compares with the angle that was commanded, and scores no translation; here the tool's recorded pose is compared.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh, sample_surface
from pipeline.registration.planar import MIN_POINTS, N_MODEL, register_planar

N_ITERATIONS = 200
_PLANE_FROM_GRASP = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # y, z, x: x becomes the axis


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspPoseError:
    """Errors in the grasp's plane."""

    translation_mm: float  # of the model's centre
    rotation_deg: float


def compute_grasp_pose_error(points_mm: Doubles, mesh: Mesh, grasp_from_object: Doubles) -> GraspPoseError | None:
    """Register contact points (n, 3) of both fingers, in the grasp frame, and compare with the true pose.

    None with too few points, which the released code answers with its start.
    """
    if len(points_mm) < MIN_POINTS:
        return None
    model_mm = sample_surface(mesh, N_MODEL, 0)[0]
    scene_mm = rigid.apply(_PLANE_FROM_GRASP, points_mm)
    fit = register_planar(model_mm, scene_mm, _PLANE_FROM_GRASP.copy(), N_ITERATIONS, starts_deg=(0.0,))
    estimate = rigid.invert(_PLANE_FROM_GRASP) @ fit.scene_from_model
    centre = model_mm.mean(axis=0)[None]
    shift = (rigid.apply(estimate, centre) - rigid.apply(grasp_from_object, centre))[0]
    turned = compute_first_euler_deg(estimate) - compute_first_euler_deg(grasp_from_object)
    return GraspPoseError(translation_mm=math.hypot(float(shift[1]), float(shift[2])), rotation_deg=abs(turned))


def compute_first_euler_deg(transform: Doubles) -> float:
    """The angle about x of a rotation R = Rx Ry Rz, in degrees, -180 to 180."""
    return math.degrees(math.atan2(-float(transform[1, 2]), float(transform[2, 2])))
