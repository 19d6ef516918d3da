"""A gel's surface, corrected until its rendered image matches the recorded one.

A calibration table knows a pixel's colour and place only. Where a dent blocks a LED, the table
takes the darkness for a slope; over a steep rim, lens blur flattens the slopes. Both follow from
the surface, so they are estimated together with it (analysis by synthesis). Each iteration renders
the surface z in a light model, compares the result with the recorded change, and takes a
Gauss-Newton step of every pixel's slopes g = grad z,

    dg = A^-1 J' W r,    A = J' W J + pull,

r the residual, J the derivatives of the rendered colours, W Huber's weights (0 where the camera is
clipped), and integrates. What a pixel cannot determine is left as the integration has it.

A wall is saturated: it looks alike at any height. While all slopes count alike, what it lacks is
taken from the flanks that are measured well. In light that is known to explain the image, the
surface is therefore the one nearest to the slopes by their certainty,

    minimise  sum (grad z - g - dg)' A (grad z - g - dg),

after what stands on walls has been raised as a whole. A wall determines its slope weakly, and what
stands between walls strongly: springs in series, of which the weak ones yield last when a surface
approaches its slopes step by step. So the surface is first moved as a whole: scaled, its walls
raised low, in the middle or high up. In light that is not the
instance's own, colours are less certain than they are clear, and this would follow the clearest.
"""

import numpy as np

from pipeline.core.arrays import Floats, percentile
from pipeline.physics.optics import compute_slopes
from pipeline.stages.depth.gel.settings import SurfaceSettings
from pipeline.stages.depth.illumination.light import (
    ImagePatch,
    Light,
    blur_change,
)
from pipeline.stages.depth.poisson import Integrator, solve_weighted_slopes


def refine_surface(
    surface_mm: Floats,
    patch: ImagePatch,
    light: Light,
    integrate: Integrator,
    iterations: int,
    settings: SurfaceSettings,
    *,
    until_settled: bool = False,
) -> tuple[Floats, float]:
    """The surface (rows, cols) in mm whose rendered image comes nearest to the recorded one, and
    the misfit.

    `surface_mm` is the first guess; `integrate` makes slopes (gx, gy) of the patch a surface. The
    misfit is in grey levels, summed over pixels and colours, before the last iteration.
    `until_settled`: one that hardly moves any pixel is the last.
    """
    import cv2

    from pipeline.stages.depth.illumination.illumination_kernels import (
        N_LINES,
        TILE_PX,
        update_slopes,
    )

    rule = light.step_rule
    misfit = 0.0
    weights = np.empty((3, *patch.changed.shape), np.float32)
    limits = tuple(
        np.float32(limit)
        for limit in (rule.pull, settings.huber_grey, rule.max_slope, settings.outside_weight)
    )
    scratch = np.empty(N_LINES * TILE_PX, np.float32)
    for _ in range(iterations):
        surface = clip_surface(surface_mm, patch, light, settings.bulge_mm)
        slopes = compute_slopes(surface, patch.pixel_mm)
        change, *rates = light.render(surface, *slopes)
        misfit = update_slopes(
            blur_change(change, patch, light.blur_px),
            (patch.change, patch.reference),
            patch.unmarked_share,
            patch.changed,
            *rates,
            limits,
            scratch,
            *slopes,
            weights,
        )
        before = surface_mm
        if rule.weighted:
            raised = raise_walls(surface_mm, slopes, weights, patch.pixel_mm, settings)
            surface_mm = solve_weighted_slopes(
                raised, slopes, weights, patch.pixel_mm, integrate, settings.cg_steps
            )
        else:
            surface_mm = integrate(*slopes)
        moved_mm = cv2.norm(surface_mm, before, cv2.NORM_INF)
        depth_mm = cv2.norm(surface_mm, cv2.NORM_INF)
        if until_settled and moved_mm < min(settings.settled_mm, settings.settled_share * depth_mm):
            break
    return surface_mm, misfit


def clip_surface(surface_mm: Floats, patch: ImagePatch, light: Light, bulge_mm: float) -> Floats:
    """The surface (rows, cols) within the range of the gel; 0 where nothing has changed."""
    return np.clip(surface_mm, bulge_mm, light.source.limits.indentation_max_mm) * patch.changed


def raise_walls(
    surface_mm: Floats,
    slopes: tuple[Floats, Floats],
    weights: Floats,
    pixel_mm: float,
    settings: SurfaceSettings,
) -> Floats:
    """The surface (rows, cols) in mm, moved as a whole toward these slopes.

    See `poisson.solve_weighted_slopes`.

    weights (3, rows, cols): the information matrix (xx, xy, yy) of each pixel's slopes.
    """
    from pipeline.stages.depth.illumination.illumination_kernels import (
        accumulate_normal_equations,
        add_shapes,
    )

    depth_mm = float(percentile(surface_mm, settings.deepest_percent))
    if depth_mm <= settings.min_depth_mm:
        return surface_mm
    surface_mm = np.require(surface_mm, np.float32, ("C", "W"))
    # the surface, and ramps from 0 to 1 between two shares of its depth
    ramps = np.array(
        [
            (1.0, 0.0, -np.inf, np.inf),
            *(
                (1.0 / (depth_mm * (high - low)), -low / (high - low), 0.0, 1.0)
                for low, high in settings.wall_ranges
            ),
        ],
        np.float32,
    )
    n = len(ramps)
    normal = np.empty((n, n))
    pull = np.empty(n)
    lines = np.empty((n + 1, 5, surface_mm.shape[1]), np.float32)
    per_px = np.float32(1.0) / np.float32(pixel_mm)
    accumulate_normal_equations(surface_mm, per_px, ramps, *slopes, weights, lines, normal, pull)
    factors = np.linalg.solve(normal + settings.wall_ridge * np.trace(normal) * np.eye(n), pull)
    raised_mm = np.empty_like(surface_mm)
    add_shapes(surface_mm, ramps, factors.astype(np.float32), raised_mm)
    return raised_mm
