"""A gel's surface, corrected until its rendered image matches the recorded one.

A calibration table knows a pixel's colour and place only. Where a dent blocks a LED, the table takes the darkness for
a slope; over a steep rim, lens blur flattens the slopes. Both follow from the surface, so they are estimated together
with it (analysis by synthesis). Each iteration renders the surface z in a light model, compares the result with the
recorded change, and takes a Gauss-Newton step of every pixel's slopes g = grad z,

    dg = A^-1 J' W r,    A = J' W J + pull,

r the residual, J the derivatives of the rendered colours, W Huber's weights (0 where the camera is clipped), and
integrates. What a pixel cannot determine is left as the integration has it.

A wall is saturated: it looks alike at any height. While all slopes count alike, what it lacks is taken from the flanks
that are measured well. In light that is known to explain the image, the surface is therefore the one nearest to the
slopes by their certainty,

    minimise  sum (grad z - g - dg)' A (grad z - g - dg),

after what stands on walls has been raised as a whole (`wall_correction`). In light that is not the instance's own,
colours are less certain than they are clear, and this would follow the clearest.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.physics.slopes import compute_slopes
from pipeline.stages.depth.illumination.constants import CONSTANTS
from pipeline.stages.depth.illumination.image_patch import (
    ImagePatch,
    blur_change,
    simulate_recorded_change,
)
from pipeline.stages.depth.illumination.light import Light
from pipeline.stages.depth.illumination.wall_correction import raise_walls
from pipeline.stages.depth.poisson import Integrator, solve_weighted_slopes


def refine_surface(
    surface_mm: Floats, patch: ImagePatch, light: Light, integrate: Integrator, iterations: int,
    cg_steps: int = CONSTANTS.cg_steps,
) -> tuple[Floats, float]:  # fmt: skip
    """The surface (rows, cols) in mm whose rendered image comes nearest to the recorded one, and the misfit.

    `surface_mm` is the first guess; `integrate` makes slopes (gx, gy) of the patch a surface. The misfit is in grey
    levels, summed over pixels and colours, before the last iteration.
    """
    from pipeline.stages.depth.illumination.illumination_kernels import N_LINES, TILE_PX, update_slopes

    rule, misfit = light.step_rule, 0.0
    weights = np.empty((3, *patch.changed.shape), np.float32)
    limits, scratch = rule.pack_limits(), np.empty(N_LINES * TILE_PX, np.float32)
    observed = patch.reference + patch.change
    for _ in range(iterations):
        surface = clip_surface(surface_mm, patch, light)
        slopes = compute_slopes(surface, patch.pixel_mm)
        change, *rates = light.render(surface, *slopes)
        residual = patch.change - simulate_recorded_change(change, patch, light.blur_px)
        misfit = update_slopes(
            residual, observed, light.confidence, patch.changed, *rates, limits, scratch, *slopes, weights
        )
        if not rule.weighted:
            surface_mm = integrate(*slopes)
            continue
        raised = raise_walls(surface_mm, slopes, weights, patch.pixel_mm)
        nearest = solve_weighted_slopes(raised, slopes, weights, patch.pixel_mm, integrate, cg_steps)
        surface_mm = surface_mm + blur_change(nearest - surface_mm, patch, light.blur_px) if rule.blurred else nearest
    return surface_mm, misfit


def clip_surface(surface_mm: Floats, patch: ImagePatch, light: Light) -> Floats:
    """The surface (rows, cols) within the range of the gel; 0 where nothing has changed."""
    return np.clip(surface_mm, CONSTANTS.bulge_mm, light.max_depth_mm) * patch.changed
