"""Contact of a gel, and its surface: the pressure that explains what was measured.

Contact is where the pressure of `pressure.estimate_pressure` is positive: above a share of the mean pressure nearby, as
slopes that are slightly wrong make some around every contact. Outside the contact the surface is what mechanics makes
of that pressure; inside it is the measured one, brought to the level of the mechanical surface around it.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.sensors.parts import Gel
from pipeline.stages.depth import regions
from pipeline.stages.depth.gel import pressure
from pipeline.stages.depth.gel.contact_settings import ContactSettings
from pipeline.stages.depth.gel.pressure import CellSurface

_KPA_TO_N_MM2 = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredSurface:
    """The part of a gel's surface that was measured, up to its level; arrays (rows, cols) of a window of the image."""

    surface_mm: Floats
    changed: Mask  # where the image shows slopes; elsewhere it is as at rest
    weight: Floats  # of the surface outside the contact: 1, falling to 0 at the end of `changed`
    rows: slice
    cols: slice
    shape: tuple[int, int]  # of the image
    pixel_mm: float
    gel: Gel


@dataclass(frozen=True, slots=True, kw_only=True)
class PressedRegion:
    """Where pressure explains a surface."""

    contact: Mask  # (rows, cols) of the image
    cells: CellSurface
    blobs: Floats  # (rows, cols) of the cells, see `pressure`: a similar frame may start from them


@dataclass(frozen=True, slots=True, kw_only=True)
class GelContact:
    """A gel under the pressure of a contact; arrays (rows, cols) of the image, zero at rest."""

    contact: Mask
    measured_mm: Floats  # levelled; the mechanical surface where nothing was measured
    mechanical_mm: Floats
    pressure_kpa: Floats  # (rows, cols) of cells
    cell_mm: float
    force_n: float
    pixel_mm: float
    fade_mm: tuple[float, float]  # distances from a contact, over which the measured surface becomes the mechanical one

    def compute_indentation(self, touched: Mask) -> Floats:
        """The surface (rows, cols) in mm: measured where `touched`, mechanical away from it."""
        import cv2

        if not touched.any():
            return self.measured_mm
        by = max(1, round(self.cell_mm / self.pixel_mm / 2))  # distances are smooth
        size = tuple(-(-n // by) for n in touched.shape[::-1])
        share = np.asarray(cv2.resize(touched.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
        away = cv2.distanceTransform((share < 0.5).astype(np.uint8), cv2.DIST_L2, 5)
        away = _resize(np.asarray(away, np.float32) * np.float32(by * self.pixel_mm), touched.shape)
        start, end = (np.float32(distance) for distance in self.fade_mm)
        keep = np.maximum(np.clip((end - away) / (end - start), np.float32(0.0), np.float32(1.0)), touched)
        return np.asarray(self.mechanical_mm + keep * (self.measured_mm - self.mechanical_mm), np.float32)


def detect_contact(
    measured: MeasuredSurface, settings: ContactSettings, contact_share: float, start: Floats | None = None
) -> PressedRegion:
    """Where the pressure behind a measured surface is more than `contact_share` of the mean nearby.

    `start`: the blobs of a similar surface of the same image size.
    """
    cells = _downsample(measured, settings)
    blobs = pressure.estimate_pressure(cells, measured.gel, settings, start)
    load = pressure.compute_pressure(blobs, cells.cell_mm, measured.gel, settings)
    excess = _compute_excess(load, cells.cell_mm, contact_share, settings)
    return PressedRegion(contact=freeze(_resize(excess, measured.shape) > 0), cells=cells, blobs=freeze(blobs))


def press_surface(
    measured: MeasuredSurface, region: PressedRegion, touched: Mask, settings: ContactSettings, least_mm: float
) -> GelContact:
    """The gel under pressure where `touched` (rows, cols) alone; contact is indented by `least_mm`, nearly."""
    gel, shape = measured.gel, measured.shape
    blobs, cells = pressure.refit_pressure(region.cells, gel, settings, region.blobs, touched)
    load = pressure.compute_pressure(blobs, cells.cell_mm, gel, settings)
    moved = pressure.compute_displacement(blobs, cells.cell_mm, gel, settings)
    offset = _compute_offset(cells, moved, blobs > 0, settings.around_share * gel.thickness_mm)
    mechanical = _resize(moved, shape)
    here = (measured.rows, measured.cols)
    levelled = measured.surface_mm - np.float32(offset)
    deep = touched.copy()
    deep[here] &= levelled > np.float32(settings.least_share * least_mm)
    touched = touched if np.array_equal(deep, touched) else regions.remove_specks(deep, settings.crumb_px)
    surface = mechanical.copy()
    surface[here] += np.maximum(measured.weight, touched[here]) * (levelled - mechanical[here])
    kpa = load * np.float32(gel.youngs_kpa / (2 * (1 - gel.poisson**2)))
    start, end = settings.fade_shares
    return GelContact(
        contact=freeze(touched), measured_mm=freeze(surface), mechanical_mm=freeze(mechanical),
        pressure_kpa=freeze(kpa), cell_mm=cells.cell_mm,
        force_n=float(kpa.sum(dtype=np.float64)) * cells.cell_mm**2 * _KPA_TO_N_MM2,
        pixel_mm=measured.pixel_mm, fade_mm=(start * gel.thickness_mm, end * gel.thickness_mm),
    )  # fmt: skip


def _downsample(measured: MeasuredSurface, settings: ContactSettings) -> CellSurface:
    """The measured surface on cells; zero where nothing was measured."""
    import cv2

    rows, cols = measured.shape
    by = math.ceil(max(measured.shape) / settings.cells_max)
    size = (-(-cols // by), -(-rows // by))
    image, changed = np.zeros(measured.shape, np.float32), np.zeros(measured.shape, np.float32)
    here = (measured.rows, measured.cols)
    image[here], changed[here] = measured.surface_mm, measured.changed
    mean = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
    share = np.asarray(cv2.resize(changed, size, interpolation=cv2.INTER_AREA), np.float32)
    return CellSurface(surface_mm=mean, inside=share > settings.cell_share, cell_mm=measured.pixel_mm * cols / size[0])


def _compute_excess(load: Floats, cell_mm: float, contact_share: float, settings: ContactSettings) -> Floats:
    """Pressure above that of the contact's edge (rows, cols), negative outside; specks and faint parts are outside.

    The mean nearby is weighted by the root of pressure: the tip of a cone, where pressure is infinite, counts less.
    """
    import cv2

    typical = pressure.weigh_by_itself(load)
    root = np.sqrt(np.where(load > np.float32(settings.mean_share * typical), load, np.float32(0.0)))
    by = max(1, int(settings.mean_mm / (settings.mean_cells * cell_mm)))  # smooth over many cells
    coarse_mm, shape = by * cell_mm, load.shape
    size = (-(-shape[1] // by), -(-shape[0] // by))
    means = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (root * root, root, load))
    squares, roots, loads = (
        np.asarray(cv2.GaussianBlur(a, (0, 0), settings.mean_mm / coarse_mm), np.float32) for a in means
    )
    reach = max(1, round(settings.reach_mm / coarse_mm))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    nearby = np.asarray(cv2.dilate(np.square(squares / np.maximum(roots, np.float32(1e-9))), disc), np.float32)
    least = np.float32(max(settings.pressure_min, settings.total_share * typical))
    excess = load - np.maximum(np.float32(contact_share) * _resize(nearby, shape), least)
    n, found = cv2.connectedComponents((excess > 0).astype(np.uint8), connectivity=8)
    parts, peaks = np.asarray(found, np.int32), np.zeros(n, np.float32)
    # Slopes that are slightly wrong make broad pressure without an edge.
    np.maximum.at(peaks, parts, load - _resize(loads, shape))
    peaks[0] = 0.0
    keep = np.bincount(parts.ravel(), minlength=n) * cell_mm**2 >= settings.part_mm2
    keep &= peaks >= np.float32(settings.part_share * typical)
    keep |= peaks >= peaks.max()  # a light touch is small and faint, but there is nothing else
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
