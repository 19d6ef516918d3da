"""Depth camera of a bubble: conversions between its lattice and depth images, and simulated frames.

A frame is the exact depth along each ray with the errors of depth cameras: noise that grows with
distance and grazing incidence, flying pixels where the depth jumps, gaps (NaN) where a surface is
too steep, and a coarse step.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.normals import compute_area_vectors
from pipeline.physics import lattice
from pipeline.physics.lattice import Lattice
from pipeline.sensors.parts import DepthCamera
from pipeline.sensors.spec import SensorSpec

_MIN_COSINE = 0.1  # noise is constant beyond 84 degrees, where there is no signal


def compute_ceiling_from_depth(
    sensor: SensorSpec, depth_mm: NDArray[np.floating], on: Lattice
) -> Doubles:
    """Height (ny, nx) in mm over the rim plane of the surface in a depth image.

    +inf without a surface.
    """
    return lattice.rasterise_depth_image(sensor.camera, depth_mm, on) - get_rim_z_mm(sensor)


def compute_depth_from_deviation(
    sensor: SensorSpec, deviation_mm: NDArray[np.floating], on: Lattice
) -> Doubles:
    """Z (rows, cols) where each camera ray meets the membrane.

    The rest depth itself where nothing deviates.
    """
    if not deviation_mm.any():
        return freeze(np.array(sensor.rest_depth_mm, dtype=np.float64))
    return lattice.intersect_rays(
        sensor.camera,
        compute_rest_z_mm(sensor, on) + deviation_mm,
        on,
        guess_mm=sensor.rest_depth_mm,
    )


def simulate_depth_frame(
    sensor: SensorSpec,
    depth_mm: NDArray[np.floating],
    seed: int | None,
    *,
    cosine: NDArray[np.floating] | None = None,
) -> Floats:
    """The depth frame (rows, cols) float32 of a membrane; NaN = no value.

    With `seed` None it is the exact depth, else it has the errors of `sensor.depth_camera`, the
    same for the same seed. `cosine` (rows, cols) is that of the incidence, if it is known already.
    """
    errs = sensor.depth_camera
    if seed is None or sensor.bubble is None or errs is None:
        return freeze(depth_mm.astype(np.float32))
    rng = np.random.default_rng(seed)
    noise = _speckle(rng.standard_normal(depth_mm.shape, np.float32), errs.grain_px)
    exact = np.asarray(depth_mm, np.float64)
    if cosine is None:
        cosine = compute_incidence_cosine(sensor.camera, exact)
    sigma = sensor.bubble.depth_noise_mm * _relative_noise(exact, cosine, errs)
    usual = _relative_noise(sensor.rest_depth_mm, compute_rest_cosine(sensor), errs)
    sigma /= np.sqrt(np.mean(usual * usual))
    seen = _with_flying_pixels(exact, errs, rng) + sigma * noise
    lost = rng.random(depth_mm.shape) < errs.gap_share
    if errs.max_incidence_deg < 90.0:
        lost |= cosine < np.cos(np.deg2rad(errs.max_incidence_deg))
    if errs.step_mm > 0:
        seen = errs.step_mm * np.rint(seen / errs.step_mm)
    return freeze(np.where(lost, np.nan, seen).astype(np.float32))


def compute_incidence_cosine(camera: Camera, depth_mm: NDArray[np.floating]) -> Doubles:
    """Cosine (rows, cols) of the angle between each ray and the surface normal.

    1 = perpendicular incidence.
    """
    points = camera.back_project(depth_mm)
    normal = compute_area_vectors(points)
    size = np.linalg.norm(normal, axis=2) * np.linalg.norm(points, axis=2)
    facing = np.abs(np.einsum("rcx,rcx->rc", normal, points))
    return np.divide(facing, size, out=np.zeros(depth_mm.shape), where=size > 0)


@derive_once
def compute_rest_cosine(sensor: SensorSpec) -> Doubles:
    """`compute_incidence_cosine` of the membrane at rest, cached."""
    rest = sensor.rest_depth_mm
    return freeze(compute_incidence_cosine(sensor.camera, rest))


def _relative_noise(depth_mm: Doubles, cosine: NDArray[np.floating], errs: DepthCamera) -> Doubles:
    """Standard deviation (rows, cols) up to a factor.

    Distance in tenths of a metre, to stay near 1.
    """
    distance = np.abs(depth_mm) / 100.0
    return distance**errs.distance_power / np.maximum(cosine, _MIN_COSINE) ** errs.grazing_power


def _with_flying_pixels(depth_mm: Doubles, errs: DepthCamera, rng: np.random.Generator) -> Doubles:
    """The depth with flying pixels: mixtures of front and back where the depth jumps."""
    import cv2

    flies = rng.random(depth_mm.shape) < errs.flying_share
    share = rng.random(depth_mm.shape)
    # continues straight: a border is no jump
    framed = np.pad(depth_mm, 1, mode="reflect", reflect_type="odd")
    bend_x = np.abs(framed[1:-1, 2:] - 2 * depth_mm + framed[1:-1, :-2])
    bend_y = np.abs(framed[2:, 1:-1] - 2 * depth_mm + framed[:-2, 1:-1])
    jump = np.maximum(bend_x, bend_y) > errs.jump_mm
    if not jump.any():
        return depth_mm
    around = np.ones((3, 3), np.uint8)
    near, far = (np.asarray(f(depth_mm, around), np.float64) for f in (cv2.erode, cv2.dilate))
    return np.where(jump & flies, near + share * (far - near), depth_mm)


def _speckle(grain: Floats, width_px: float) -> Floats:
    """White noise blurred to the grain of a depth camera, of the same strength."""
    import cv2

    if width_px <= 0:
        return grain
    reach = max(1, round(4 * width_px))
    weights = np.asarray(cv2.getGaussianKernel(2 * reach + 1, width_px))[:, 0]
    # variance left by a blur along both axes, as a standard deviation
    keeps = float((weights**2).sum())
    return np.asarray(cv2.sepFilter2D(grain, cv2.CV_32F, weights, weights) / keeps, np.float32)


def get_rim_z_mm(sensor: SensorSpec) -> float:
    """Distance in mm of the rim plane from the camera."""
    return float(sensor.membrane.z_mm.min())


def compute_rest_z_mm(sensor: SensorSpec, on: Lattice) -> Doubles:
    """Z (ny, nx) in mm of the membrane at rest at the lattice's nodes."""
    return sensor.membrane.depth_at(on.x_mm()[None, :], on.y_mm()[:, None])
