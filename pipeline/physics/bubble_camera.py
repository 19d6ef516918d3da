"""Between the bubble's lattice and what its depth camera sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Doubles, Floats, freeze
from pipeline.physics import lattice
from pipeline.physics.lattice import Lattice
from pipeline.sensors.spec import SensorSpec

_SPECKLE_PX = 0.8  # width of the grain in the paper's bubble pictures
_SPECKLE_KEEPS = 0.354  # standard deviation of unit noise after that blur


def ceiling_from_depth(sensor: SensorSpec, depth_mm: NDArray[np.floating], on: Lattice) -> Doubles:
    """Height over the rim plane (ny, nx) of the surface in a depth image; +inf where it shows none."""
    return lattice.nearest_of_depth_image(sensor.camera, depth_mm, on) - rim_z_mm(sensor)


def depth_from_deviation(sensor: SensorSpec, deviation_mm: NDArray[np.floating], on: Lattice) -> Doubles:
    """Z (rows, cols) where each camera ray meets the membrane; the rest depth itself where nothing deviates."""
    if not deviation_mm.any():
        return freeze(np.array(sensor.rest_depth_mm, dtype=np.float64))
    return lattice.depth_along_rays(
        sensor.camera, rest_z_mm(sensor, on) + deviation_mm, on, guess_mm=sensor.rest_depth_mm
    )


def reading(sensor: SensorSpec, depth_mm: NDArray[np.floating], seed: int | None) -> Floats:
    """The depth camera's image (rows, cols) float32 of a membrane, with its noise unless `seed` is None."""
    if seed is None or sensor.bubble is None:
        return freeze(depth_mm.astype(np.float32))
    grain = np.random.default_rng(seed).standard_normal(depth_mm.shape, np.float32)
    return freeze((depth_mm + sensor.bubble.depth_noise_mm * _speckle(grain)).astype(np.float32))


def _speckle(grain: Floats) -> Floats:
    """White noise made as coarse as a depth camera's, which shares light between neighbours; its strength is kept."""
    import cv2

    return np.asarray(cv2.GaussianBlur(grain, (0, 0), _SPECKLE_PX) / _SPECKLE_KEEPS, np.float32)


def rim_z_mm(sensor: SensorSpec) -> float:
    """Distance of the rim plane from the camera."""
    return float(sensor.membrane.z_mm.min())


def rest_z_mm(sensor: SensorSpec, on: Lattice) -> Doubles:
    """Z (ny, nx) of the untouched membrane at the lattice's nodes."""
    return sensor.membrane.depth_at(on.x_mm()[None, :], on.y_mm()[:, None])
