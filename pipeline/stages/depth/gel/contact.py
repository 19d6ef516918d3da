"""Contact of a gel, and its surface: the pressure that explains what was measured.

Contact is where the pressure of `pressure.estimate_pressure` is positive: above a share of the mean pressure nearby, as
slopes that are slightly wrong make some around every contact. Outside the contact the surface is what mechanics makes of
that pressure; inside it is the measured one, brought to the level of the mechanical surface around it.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.sensors.parts import Gel
from pipeline.stages.depth.gel import pressure
from pipeline.stages.depth.gel.contact_settings import ContactSettings
from pipeline.stages.depth.gel.pressure import CellSurface

_KPA_TO_N_MM2 = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredSurface:
    """The part of a gel's surface that was measured, up to its level."""

    surface_mm: Floats  # (rows, cols) of the window
    changed: Mask  # (rows, cols) of the window: where the surface was measured; elsewhere the image is as at rest
    rows: slice  # of the image
    cols: slice
    shape: tuple[int, int]  # of the image
    pixel_mm: float
    gel: Gel


@dataclass(frozen=True, slots=True, kw_only=True)
class GelContact:
    """A gel under the pressure that explains its surface; arrays (rows, cols) of the image, zero at rest."""

    contact: Mask
    measured_mm: Floats  # levelled; the mechanical surface where nothing was measured
    mechanical_mm: Floats
    pressure_kpa: Floats  # (rows, cols) of the cells
    blobs: Floats  # (rows, cols) of the cells: where the next frame may start
    cell_mm: float
    force_n: float
    pixel_mm: float
    gel: Gel

    def compute_indentation(self, touched: Mask, settings: ContactSettings) -> Floats:
        """The surface (rows, cols) in mm: measured where `touched`, mechanical away from it."""
        import cv2

        if not touched.any():
            return self.mechanical_mm
        away = cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5)
        start, end = (share * self.gel.thickness_mm / self.pixel_mm for share in settings.fade_shares)
        keep = np.clip((np.float32(end) - np.asarray(away, np.float32)) / np.float32(end - start), 0.0, 1.0)
        return np.asarray(self.mechanical_mm + keep * (self.measured_mm - self.mechanical_mm), np.float32)


def estimate_contact(
    measured: MeasuredSurface,
    settings: ContactSettings,
    *,
    least_mm: float,
    contact_share: float,
    start: Floats | None = None,
) -> GelContact:
    """The contact of a measured surface.

    Contact is indented by more than `least_mm`, under more than `contact_share` of the mean pressure nearby. `start`:
    the `blobs` of a similar surface of the same image size.
    """
    on, image_mm, changed = _downsample(measured, settings)
    blobs = pressure.estimate_pressure(on, measured.gel, settings, start)
    load = pressure.compute_pressure(blobs, on.cell_mm, measured.gel, settings)
    excess = _compute_excess(load, on.cell_mm, contact_share, settings)
    touched = _resize(excess, measured.shape) > 0
    refitted, cells = pressure.refit_pressure(on, measured.gel, settings, blobs, excess > 0)
    load = pressure.compute_pressure(refitted, cells.cell_mm, measured.gel, settings)
    moved = pressure.compute_displacement(refitted, cells.cell_mm, measured.gel, settings)
    offset = _compute_offset(cells, moved, refitted > 0, settings.around_share * measured.gel.thickness_mm)
    mechanical = _resize(moved, measured.shape)
    levelled = np.where(changed, image_mm - np.float32(offset), mechanical)
    touched &= levelled > np.float32(settings.least_share * least_mm)
    kpa = load * np.float32(measured.gel.youngs_kpa / (2 * (1 - measured.gel.poisson**2)))
    return GelContact(
        contact=freeze(touched), measured_mm=freeze(levelled), mechanical_mm=freeze(mechanical),
        pressure_kpa=freeze(kpa), blobs=freeze(blobs), cell_mm=cells.cell_mm,
        force_n=float(kpa.sum(dtype=np.float64)) * cells.cell_mm**2 * _KPA_TO_N_MM2,
        pixel_mm=measured.pixel_mm, gel=measured.gel,
    )  # fmt: skip


def _downsample(measured: MeasuredSurface, settings: ContactSettings) -> tuple[CellSurface, Floats, Mask]:
    """The surface on cells, and on the pixels of the image with the mask of what was measured; zero elsewhere."""
    import cv2

    rows, cols = measured.shape
    by = math.ceil(max(measured.shape) / settings.cells_max)
    size = (-(-cols // by), -(-rows // by))
    image, changed = np.zeros(measured.shape, np.float32), np.zeros(measured.shape, np.bool_)
    here = (measured.rows, measured.cols)
    image[here], changed[here] = np.where(measured.changed, measured.surface_mm, np.float32(0.0)), measured.changed
    mean = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
    share = np.asarray(cv2.resize(changed.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    inside = share > settings.cell_share
    on = CellSurface(
        surface_mm=np.where(inside, mean, np.float32(0.0)), inside=inside, cell_mm=measured.pixel_mm * cols / size[0]
    )
    return on, image, changed


def _compute_excess(load: Floats, cell_mm: float, contact_share: float, settings: ContactSettings) -> Floats:
    """Pressure above that of the contact's edge (rows, cols), negative outside; specks and faint parts are outside."""
    import cv2

    width, reach = settings.mean_mm / cell_mm, max(1, round(settings.reach_mm / cell_mm))
    squares, loads = (np.asarray(cv2.GaussianBlur(a, (0, 0), width), np.float32) for a in (load * load, load))
    mean = squares / np.maximum(loads, np.float32(1e-9))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    typical = pressure.weigh_by_itself(load)
    edge = np.float32(contact_share) * np.asarray(cv2.dilate(mean, disc), np.float32)
    excess = load - np.maximum(edge, np.float32(max(settings.pressure_min, settings.total_share * typical)))
    n, found = cv2.connectedComponents((excess > 0).astype(np.uint8), connectivity=8)
    parts, peaks = np.asarray(found, np.int32), np.zeros(n, np.float32)
    np.maximum.at(peaks, parts, load - loads)  # slopes that are slightly wrong make broad pressure without an edge
    peaks[0] = 0.0
    keep = np.bincount(parts.ravel(), minlength=n) * cell_mm**2 >= settings.part_mm2
    keep &= peaks >= min(np.float32(settings.part_share * typical), peaks.max())
    return np.where(keep[parts] | (parts == 0), excess, np.minimum(excess, -load))


def _compute_offset(on: CellSurface, moved: Floats, touched: Mask, reach_mm: float) -> float:
    """How much higher than the mechanical surface the measured one is, around the contact; anywhere, if not there."""
    import cv2

    away = np.asarray(cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5), np.float32)
    outside = on.inside & ~touched
    near = outside & (away * np.float32(on.cell_mm) < reach_mm)
    where = near if near.any() else outside
    return float(np.mean((on.surface_mm - moved)[where], dtype=np.float64)) if where.any() else 0.0


def _resize(field: Floats, shape: tuple[int, ...]) -> Floats:
    """A field on cells, interpolated on the pixels of `shape`."""
    import cv2

    return np.asarray(cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)
