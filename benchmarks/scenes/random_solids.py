"""Closed random solids for judging: primitives joined and cut, in no catalogue and in no
training data.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.arrays import freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh

_STEP_MM = 0.5
_HALF_MM = 20.0


def make_random_solid(seed: int) -> Mesh:
    """A solid of two to five boxes, balls, cylinders and cones.

    Its lowest point lies at z = 0 and faces -z.
    """
    from skimage.measure import marching_cubes

    rng = np.random.default_rng(seed)
    at = np.arange(-_HALF_MM, _HALF_MM + _STEP_MM / 2, _STEP_MM)
    grid = np.stack(np.meshgrid(at, at, at, indexing="ij"), -1)
    body = _measure_primitive(rng, grid, size_mm=rng.uniform(5.0, 10.0))
    for _ in range(rng.integers(1, 5)):
        part = _measure_primitive(rng, grid, size_mm=rng.uniform(2.0, 7.0))
        body = np.maximum(body, -part) if rng.random() < 0.3 else np.minimum(body, part)
    vertices, triangles, _, _ = marching_cubes(
        body, 0.0, spacing=(_STEP_MM,) * 3, gradient_direction="descent"
    )
    vertices -= (*(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))[:2], vertices[:, 2].min())
    return Mesh(
        vertices_mm=freeze(vertices.astype(np.float64)),
        triangles=freeze(triangles.astype(np.int32)),
        name=f"solid {seed}",
    )


def _measure_primitive(rng, grid, size_mm):
    """Signed distance (mm, negative inside) to one turned and shifted primitive."""
    turn = rigid.rotation(rng.normal(size=3))[:3, :3]
    p = (grid - rng.uniform(-6.0, 6.0, 3)) @ turn
    kind = rng.integers(4)
    sides = size_mm * rng.uniform(0.3, 1.2, 3)
    across = np.hypot(p[..., 0], p[..., 1])
    if kind == 0:
        over = np.abs(p) - sides
        return np.linalg.norm(np.maximum(over, 0.0), axis=-1) + np.minimum(over.max(axis=-1), 0.0)
    if kind == 1:
        return (np.linalg.norm(p / sides, axis=-1) - 1.0) * sides.min()
    if kind == 2:
        return np.maximum(across - 0.5 * sides[0], np.abs(p[..., 2]) - sides[1])
    return np.maximum(0.8 * across + 0.6 * p[..., 2] - 0.5 * sides[0], -p[..., 2] - 0.7 * sides[1])
