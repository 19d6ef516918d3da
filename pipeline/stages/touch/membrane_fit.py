"""Fit of an object's pose to the whole membrane of a bubble: analysis by synthesis.

The contact alone leaves a pose open: it is small, and smooth where the membrane bends around an
edge. The membrane around it is as exactly known from physics. So the mesh is pressed into the
source, and the pose is moved until what the depth camera measured is explained: Gauss-Newton on
block means with the weights of Geman and McClure 1985, its derivatives from presses on a coarser
lattice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.results import DepthMap
from pipeline.physics.simulation.press import press_membrane
from pipeline.sensors.spec import SensorSpec

_BLOCK = 4.0  # pixels along a block: wider than the grain of the noise, finer than a membrane bends
_FINE = 2.0  # pixels along a block of the press that corrects those on coarser lattices
_TRIED_MM = 0.3  # motion for a derivative
_LOOSE_MM = 3.0  # standard deviation of a motion before the fit
_MAX_STEP_MM = 1.5
_CONVERGED_MM = 0.03
_N_ROUNDS = 2
_MAX_STEPS = 4
_LEAST_NOISE_MM = 0.03  # of a block
# Of a surface measured by light, where it states less: a press on a coarse lattice, and what the
# light of a contact at the image border or of an unlike sensor instance hides.
_LEAST_STD_MM = 0.01
_LEAST_STD_SHARE = 0.12  # of the largest indentation
_OUTLIER_STDS = 3.0
_SMOOTH = 3  # blocks over which independent noise averages out and a misfit does not


@frozen
class MembraneFit:
    """A pose, its covariance, and how far the membrane is explained."""

    sensor_from_object: Doubles  # (4, 4) mm
    covariance: Doubles  # (6, 6) of (rotation rad, translation mm) about the point given
    # smooth part of the residual, relative to what the noise leaves; about 1 = explained
    misfit: float


@frozen
class PressResidual:
    """What a press of a mesh leaves unexplained of the membrane that a source measured."""

    rms_mm: float  # over the image
    misfit: float  # where either touches, over what the depth can be off by; about 1 = all of it


def measure_residuals(
    depth: DepthMap, mesh: Mesh, source: SensorSpec, poses: Sequence[Doubles]
) -> tuple[PressResidual, ...]:
    """The residual over blocks of the mesh pressed into the source at each pose (4, 4).

    The sum of squares of a misfit is over the blocks that the depth says touch. A depth that is
    wrong, and says so, blames no mesh.
    """
    small = source.with_camera(source.camera.scale(1.0 / _BLOCK))
    measured, known = _average_blocks(_measure_displacement(depth), small)
    touched = _average_blocks(depth.contact.astype(np.float32), small)[0] > 0.5
    stated_mm = 0.0 if depth.error is None else depth.error.rms_mm
    deepest_mm = float(np.nanmax(depth.indentation_mm))
    std_mm = math.hypot(stated_mm, _LEAST_STD_MM, _LEAST_STD_SHARE * deepest_mm)
    residuals: list[PressResidual] = []
    for pose in poses:
        pressed = press_membrane(mesh, pose, small)
        square = (measured - small.rest_depth_mm + pressed.depth_mm) ** 2
        in_zone = square[known & (touched | pressed.contact)].sum()
        residuals.append(
            PressResidual(
                rms_mm=math.sqrt(square[known].mean()),
                misfit=math.sqrt(in_zone / max(1, int(touched.sum()))) / std_mm,
            )
        )
    return tuple(residuals)


def fit_membrane(
    depth: DepthMap,
    mesh: Mesh,
    source: SensorSpec,
    start: Doubles,
    about_mm: Doubles,
    radius_mm: float,
) -> MembraneFit:
    """Fit the pose near `start` to the measured membrane.

    Motions are taken about a point and scaled by a radius.
    """
    small, fine = (source.with_camera(source.camera.scale(1.0 / n)) for n in (_BLOCK, _FINE))
    measured, known = _average_blocks(_measure_displacement(depth), small)
    measured = measured[known]

    def predict(pose: Doubles, sensor: SensorSpec = small) -> Floats:
        moved = sensor.rest_depth_mm - press_membrane(mesh, pose, sensor).depth_mm
        return np.asarray(
            moved if sensor is small else _average_blocks(moved, small)[0], np.float32
        )[known]

    def move(pose: Doubles, motion_mm: Doubles) -> Doubles:
        return rigid.apply_screw(pose, motion_mm / to_mm, about_mm)

    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)
    pose = start
    coarse = predict(pose)
    residual = measured
    noise_mm = 0.0
    information = np.zeros((6, 6))
    for _ in range(_N_ROUNDS):
        rest = measured - predict(pose, fine) + coarse  # what the coarser lattice should predict
        noise_mm = _measure_noise_mm(rest - coarse)
        pose, information, moved_mm, coarse = _minimise(rest, predict, move, pose, coarse, noise_mm)
        residual = rest - coarse
        if moved_mm < _TRIED_MM:
            break
    noise_mm = _measure_noise_mm(residual)
    covariance = np.linalg.inv(information + np.eye(6) / _LOOSE_MM**2) / np.outer(to_mm, to_mm)
    field = np.zeros(known.shape, np.float32)
    field[known] = np.clip(residual, -_OUTLIER_STDS * noise_mm, _OUTLIER_STDS * noise_mm)
    misfit = _measure_smooth_share(field, noise_mm)
    covariance *= max(1.0, misfit) ** 2  # the residual is correlated over blocks
    return MembraneFit(
        sensor_from_object=freeze(pose), covariance=freeze(covariance), misfit=misfit
    )


def _measure_noise_mm(residual: Floats) -> float:
    """Robust standard deviation of blocks; not below the least."""
    return max(1.4826 * float(np.median(np.abs(residual))), _LEAST_NOISE_MM)


def _minimise(
    wanted: Floats,
    predict: Callable[[Doubles], Floats],
    move: Callable[[Doubles, Doubles], Doubles],
    pose: Doubles,
    predicted: Floats,
    noise_mm: float,
) -> tuple[Doubles, Doubles, float, Floats]:
    """(pose, its information (6, 6) per mm^2, how far it moved in mm, its prediction) of the
    least robust cost.
    """
    slopes = np.zeros((0, 6))
    information = np.eye(6)
    damping = 1.0
    far_mm = 0.0
    for _ in range(_MAX_STEPS):
        if not len(slopes):
            slopes = (
                np.stack([predict(move(pose, _TRIED_MM * e)) - predicted for e in np.eye(6)], 1)
                / _TRIED_MM
            )
        residual = wanted - predicted
        weights = _weigh(residual, noise_mm) / noise_mm**2
        information = np.einsum("ni,n,nj->ij", slopes, weights, slopes)
        pull = np.einsum("ni,n->i", slopes, weights * residual)
        step = np.linalg.solve(information + damping * np.eye(6) / _LOOSE_MM**2, pull)
        largest_mm = float(np.abs(step).max())
        step *= min(1.0, _MAX_STEP_MM / largest_mm)
        if largest_mm < _CONVERGED_MM:
            break
        trial = move(pose, step)
        then = predict(trial)
        if _cost(wanted - then, noise_mm) < _cost(residual, noise_mm):
            pose = trial
            predicted = then
            damping = max(1.0, 0.1 * damping)
            far_mm = far_mm + largest_mm
            # far from where they were taken
            slopes = slopes[:0] if largest_mm > _TRIED_MM else slopes
        else:
            damping *= 30.0
    return pose, information, far_mm, predicted


def _measure_displacement(depth: DepthMap) -> Floats:
    """Displacement (rows, cols) of the membrane with the camera's noise; NaN = not measured."""
    if depth.measured_depth_mm is None:
        return depth.indentation_mm
    return np.asarray(depth.depth_mm + depth.indentation_mm - depth.measured_depth_mm, np.float32)


def _average_blocks(field: np.ndarray, small: SensorSpec) -> tuple[Floats, np.ndarray]:
    """(mean, known) of blocks of pixels."""
    import cv2

    finite = np.isfinite(field)
    size = small.camera.shape[::-1]
    total = cv2.resize(
        np.where(finite, field, 0.0).astype(np.float32), size, interpolation=cv2.INTER_AREA
    )
    share = np.asarray(cv2.resize(finite.astype(np.float32), size, interpolation=cv2.INTER_AREA))
    return np.asarray(total / np.maximum(share, 1e-6), np.float32), share > 0.5


def _weigh(residual: Floats, noise_mm: float) -> Floats:
    return (1.0 + (residual / (_OUTLIER_STDS * noise_mm)) ** 2) ** -2


def _cost(residual: Floats, noise_mm: float) -> float:
    square = (residual / noise_mm) ** 2
    return float((square / (1.0 + square / _OUTLIER_STDS**2)).sum())


def _measure_smooth_share(field: Floats, noise_mm: float) -> float:
    """Rms of a residual averaged over neighbouring blocks, relative to that of independent
    noise.
    """
    import cv2

    smooth = np.asarray(cv2.blur(field, (_SMOOTH, _SMOOTH)))
    return _SMOOTH * float(np.sqrt((smooth**2).mean())) / noise_mm
