"""What a change of the light makes of a picture beyond what a change of the surface explains (variable projection)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats
from pipeline.physics.slopes import compute_slopes
from pipeline.stages.depth import surface_refinement
from pipeline.stages.depth.poisson import Integrator, solve_weighted_slopes
from pipeline.stages.depth.surface_refinement import ImagePatch

SLOPE_STEP = np.float32(0.02)  # mm/mm, for rates of change
_PULL = np.float32(100.0)  # as `gel_light` has it
_OUTSIDE = np.array([surface_refinement.OUTSIDE_WEIGHT, 0.0, surface_refinement.OUTSIDE_WEIGHT], np.float32)
_BENT_STEPS = 3  # towards the surface that a change of the lamps bends
_TELLS = (2.0, 252.0)  # grey levels between which a camera tells


def project_out_surface(
    columns: Floats, across: Floats, down: Floats, weight: Floats, picture: ImagePatch, integrated: Integrator
) -> None:
    """Take from `columns` (m, rows, cols, 3), changes of a picture, what the surface that explains most of each makes.

    across, down (rows, cols, 3): what the two slopes change; weight (rows, cols, 3): how much a colour counts.
    """
    xx, xy, yy = _sum(weight, across, across) + _PULL, _sum(weight, across, down), _sum(weight, down, down) + _PULL
    sure = np.where(picture.changed[..., None], np.stack([xx, xy, yy], axis=2), _OUTSIDE)
    per = picture.changed / (xx * yy - xy * xy)
    to_x, to_y = (per * np.einsum("rck,rck,nrck->nrc", weight, way, columns) for way in (across, down))
    wanted = _single(yy * to_x - xy * to_y), _single(xx * to_y - xy * to_x)
    still = np.zeros_like(wanted[0])
    bent = (
        solve_weighted_slopes(still, wanted, _single(sure), picture.pixel_mm, integrated, _BENT_STEPS) * picture.changed
    )
    for along, bends in zip((across, down), compute_slopes(bent, picture.pixel_mm), strict=True):
        columns -= along * bends[..., None]


def compute_colour_weights(rest: Floats, picture: ImagePatch) -> Floats:
    """How much every colour (rows, cols, 3) counts of which `rest` is left."""
    seen, (dark, bright) = picture.reference + picture.change, _TELLS
    tells = (seen > dark) & (seen < bright) & picture.changed[..., None]
    huber = np.float32(surface_refinement.HUBER_GREY)
    return np.asarray(
        tells * picture.unmarked_share * np.minimum(1.0, huber / np.maximum(np.abs(rest), huber)), np.float32
    )


def _single(field: NDArray[np.floating]) -> Floats:
    return np.asarray(field, np.float32)


def _sum(weight: Floats, a: Floats, b: Floats) -> Floats:
    """Of the colours of every pixel (rows, cols)."""
    return _single(np.einsum("rck,rck,rck->rc", weight, a, b))
