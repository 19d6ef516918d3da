"""Node *surface*: the surface of a gel by its slopes, corrected by rendering it in the frame's light."""

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.params import NoParams
from pipeline.base.progress import Progress
from pipeline.stages.depth.gel.result import NOT_SCALED
from pipeline.stages.depth.gel.slopes import FrameSlopes
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import FrameLight, Illumination, upsample_surface


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSurface:
    """A surface as light shows it, before mechanics tell what of it touches."""

    surface_mm: Floats  # (rows, cols) of the window; 0 in the median outside the changed region
    notes: tuple[str, ...]


def estimate_surface(slopes: FrameSlopes, light: FrameLight, _params: NoParams, progress: Progress) -> FrameSurface:
    """The surface of slopes in a light; it can be cancelled at every iteration."""
    progress.step(0.0, "integrating slopes")
    changed = slopes.changed
    window, calibration, notes = changed.window, changed.calibration, tuple[str, ...]()
    surface = _integrate(slopes, light.illumination, progress)
    if light.illumination is not None and light.illumination.is_bound_to_place:
        corner = (window.rows.start, window.cols.start)
        surface = surface * np.float32(calibration.compute_depth_scale(surface, corner))
    elif calibration.depth_scale_map is not None:
        notes = (NOT_SCALED,)
    return FrameSurface(surface_mm=freeze(surface), notes=notes)


def _integrate(slopes: FrameSlopes, illumination: Illumination | None, progress: Progress) -> Floats:
    changed = slopes.changed
    patch, cells = changed.patches
    if illumination is None:
        return changed.make_integrator(patch, progress)(slopes.gx, slopes.gy)
    integrate = changed.make_integrator(cells, progress)
    guess = integrate(slopes.gx, slopes.gy)
    surface = selection.correct_surface(guess, cells, changed.source, illumination, integrate)
    if cells is patch:
        return surface
    surface = upsample_surface(surface, cells.downsampling, changed.window.changed.shape)
    integrate = changed.make_integrator(patch, progress, 0.6)
    return selection.add_detail(surface, patch, changed.source, illumination, integrate)
