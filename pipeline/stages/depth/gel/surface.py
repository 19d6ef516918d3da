"""Node *surface*: the surface of a gel by its slopes, corrected by rendering it in the frame's
light.
"""

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.core.frozen import frozen
from pipeline.core.params import NoParams
from pipeline.core.progress import Progress
from pipeline.physics.optics import compute_slopes
from pipeline.stages.depth.contact import find_box
from pipeline.stages.depth.gel.change import FrameChange
from pipeline.stages.depth.gel.result import NOT_SCALED
from pipeline.stages.depth.gel.settings import SLOPES, SURFACE
from pipeline.stages.depth.gel.slopes import ChangedImage, FrameSlopes, find_boundaries
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import (
    FrameLight,
    Illumination,
    ImagePatch,
    compute_cell_means,
    upsample_surface,
)
from pipeline.stages.depth.poisson import Boundary, Integrator


@frozen
class FrameSurface:
    """A surface as light shows it, before mechanics tell what of it touches."""

    surface_mm: Floats  # (rows, cols) of the window; 0 in the median outside the changed region
    notes: tuple[str, ...]


def estimate_surface(
    change: FrameChange,
    slopes: FrameSlopes,
    light: FrameLight,
    _params: NoParams,
    progress: Progress,
) -> FrameSurface:
    """The surface of slopes in a light; it can be cancelled at every iteration.

    Shadows that are cast next to a touch look like ridges in a shading field: where LEDs cast them,
    its slopes count only near the coarse dent.
    """
    progress.step(0.0, "integrating slopes")
    changed = slopes.changed
    window = changed.window
    calibration = changed.calibration
    notes = tuple[str, ...]()
    surface = _integrate(slopes, light.illumination, change.press.dent_mm, progress)
    if light.illumination is not None and light.illumination.is_bound_to_place:
        corner = (window.rows.start, window.cols.start)
        surface = surface * np.float32(calibration.compute_depth_scale(surface, corner))
    elif calibration.depth_scale_map is not None:
        notes = (NOT_SCALED,)
    return FrameSurface(surface_mm=freeze(surface), notes=notes)


def _integrate(
    slopes: FrameSlopes, illumination: Illumination | None, dent_mm: Floats, progress: Progress
) -> Floats:
    changed = slopes.changed
    patch, cells = changed.patches
    if illumination is None:
        return changed.make_integrator(patch, progress)(slopes.gx, slopes.gy)
    integrate = changed.make_integrator(cells, progress)
    guess = integrate(slopes.gx, slopes.gy)
    surface = selection.correct_surface(guess, cells, changed.source, illumination, integrate)
    if illumination.model == "field" and selection.casts_shadows(changed.source):
        near = _weigh_by_distance(dent_mm, changed, cells)
        gx, gy = compute_slopes(surface, cells.pixel_mm)
        surface = integrate(gx * near, gy * near)
    surface = upsample_surface(surface, cells.downsampling, changed.window.changed.shape)
    if illumination.is_trusted:
        progress.step(0.6, "raising walls")
        _raise_walls(surface, patch, changed, illumination)
    return surface


def _raise_walls(
    surface: Floats, patch: ImagePatch, changed: ChangedImage, illumination: Illumination
) -> None:
    """Raise the walls of a surface (rows, cols) in place at the image's own resolution, where they
    are steeper.

    They lie in the dent: beyond a margin around it nothing moves.
    """
    deepest_mm = surface.max()
    if deepest_mm <= SURFACE.min_depth_mm:
        return
    margin = round(SURFACE.wall_margin_mm / patch.pixel_mm)
    box = find_box(surface > SURFACE.wall_ranges[0][0] * deepest_mm, margin)
    rows, cols = box
    window = changed.window
    ends = find_boundaries(
        _shift(rows, window.rows.start), _shift(cols, window.cols.start), changed.image.shape
    )
    arrays = {
        name: np.ascontiguousarray(getattr(patch, name)[box])
        for name in ("change", "reference", "changed", "unmarked_share")
    }
    raised = selection.add_walls(
        np.ascontiguousarray(surface[box]),
        replace(patch, x_px=patch.x_px[cols], y_px=patch.y_px[rows], **arrays),
        changed.source,
        illumination,
        Integrator(pixel_mm=patch.pixel_mm, sides=ends),
    )
    down = _make_fade(raised.shape[0], margin, ends.top, ends.bottom)
    across = _make_fade(raised.shape[1], margin, ends.left, ends.right)
    surface[box] += np.minimum.outer(down, across) * (raised - surface[box])


def _shift(span: slice, by: int) -> slice:
    return slice(span.start + by, span.stop + by)


def _make_fade(n: int, margin: int, *ends: Boundary) -> Floats:
    """Weights (n,) that rise from 0 to 1 over a margin from either end that is flat."""
    rise = np.arange(n, dtype=np.float32) / np.float32(margin)
    sides = [side for side, end in zip((rise, rise[::-1]), ends, strict=True) if end == "flat"]
    return np.minimum.reduce([*sides, np.ones_like(rise)])


def _weigh_by_distance(dent_mm: Floats, changed: ChangedImage, cells: ImagePatch) -> Floats:
    """Weights of the cells (rows, cols) that fall to 0 within a reach of the coarse dent (rows,
    cols) of the image.
    """
    import cv2

    dent = np.asarray(
        cv2.resize(dent_mm, changed.image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    )
    outside = (dent < SLOPES.dent_share * dent.max()).astype(np.uint8)
    away_px = np.asarray(cv2.distanceTransform(outside, cv2.DIST_L2, 5), np.float32)
    away_px = compute_cell_means(
        away_px[changed.window.rows, changed.window.cols], cells.downsampling
    )
    reach_px = np.float32(SURFACE.reach_mm / changed.calibration.pixel_mm)
    return np.clip(np.float32(1.0) - away_px / reach_px, np.float32(0.0), np.float32(1.0))
