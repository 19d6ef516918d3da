"""Meshes as height fields and as images: the one z-buffer that simulation, rest surfaces and
videos draw with.
"""

import numpy as np

from pipeline.core.arrays import Doubles, Indices, freeze
from pipeline.core.geometry.camera import Camera


def rasterise_triangles(
    nodes: Doubles, triangles: Indices, shape: tuple[int, int]
) -> tuple[Doubles, Indices]:
    """The lowest height (rows, cols) at each node of a grid, +inf without one, and the triangle
    that has it, or -1.

    nodes (n, 3): column, row and height of the corners. Common edges belong to both triangles. A
    corner that is not finite removes its triangles.
    """
    from pipeline.core.geometry.membrane_kernels import lower_to_triangles

    height = np.full(shape, np.inf)
    drawn = np.full(shape, -1, np.int32)
    lower_to_triangles(np.ascontiguousarray(nodes), triangles, height, drawn)
    return height, drawn


def render_mesh(
    vertices_mm: Doubles, triangles: Indices, camera: Camera
) -> tuple[Doubles, Indices]:
    """Z (rows, cols) in mm of the nearest surface that each pixel sees, NaN outside.

    And its triangle, or -1.

    Vertices (n, 3) are in the camera's frame; those behind the lens remove their triangles. 1 / z
    is linear in the image, so that triangles are rasterised as over a grid.
    """
    x_px, y_px, _ = camera.project(vertices_mm)
    z = np.where(vertices_mm[:, 2] > 0.0, vertices_mm[:, 2], np.nan)
    height, drawn = rasterise_triangles(
        np.stack([x_px, y_px, -1.0 / z], axis=-1), triangles, camera.shape
    )
    return freeze(np.where(drawn >= 0, -1.0 / height, np.nan)), freeze(drawn)
