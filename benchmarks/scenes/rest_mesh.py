"""A rest surface as triangles, for baselines and files that know nothing else. Not a question
itself.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.arrays import freeze
from pipeline.core.geometry.membrane import Membrane
from pipeline.core.geometry.meshes import Mesh


def rest_mesh(surface: Membrane) -> Mesh:
    """The rest surface in the sensor frame, two triangles to each cell of its lattice."""
    ny, nx = surface.z_mm.shape
    y, x = np.mgrid[:ny, :nx] * surface.step_mm
    vertices = np.stack([x + surface.x0_mm, y + surface.y0_mm, surface.z_mm], axis=-1).reshape(
        -1, 3
    )
    first = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)[None, :]).ravel()
    upper = np.stack([first, first + 1, first + nx], axis=-1)
    lower = np.stack([first + 1, first + nx + 1, first + nx], axis=-1)
    triangles = np.concatenate([upper, lower]).astype(np.int32)
    return Mesh(vertices_mm=freeze(vertices), triangles=freeze(triangles), name="rest surface")
