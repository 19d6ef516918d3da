"""Removal of false contacts: broad, shallow regions that drift of the light leaves next to a touch."""

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Indices, Mask, median, percentile
from pipeline.physics.slopes import compute_slopes
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.gel_surface import ChangedImage
from pipeline.stages.depth.illumination.light import (
    Illumination,
    ImagePatch,
    compute_cell_means,
    simulate_recorded_change,
)
from pipeline.stages.depth.illumination.surface_refinement import clip_surface

_REACH_MM = 0.8  # around a region: the flanks of a dent lie partly outside its contact
# Measured over the touches of `benchmarks/real_depth.py`, `real_things.py` and `drift.py`: balls have at most 0.6 of
# their change in one direction, other objects 0.83, spots of light from 0.94 on.
_ONE_DIRECTION = 0.85
# Share of the squared change that the surface explains. Weak touches (below the sensor's limit of a change without
# contact, root mean square): from 0.4 on, glints 0.2, a dithered film up to 0.35. Strong touches in unknown light may
# have 0.04; strong glints have less than none, -0.2 to -0.6.
_EXPLAINED_MIN_WEAK, _EXPLAINED_MIN = 0.36, 0.0


def remove_light_changes(
    touched: Mask, surface_mm: Floats, changed: ChangedImage, illumination: Illumination | None
) -> Mask:
    """The contact `touched` (rows, cols) of the window without regions that are changes of the light.

    Glints, spots of stray light, dithering: a touch is a dent, and a dent explains what is visible of it in two ways.
    Its flanks face opposite LEDs, so each colour rises on one flank and falls on the other; a spot of light changes the
    whole region in one direction. And the dent, rendered in the light that it was measured by, looks like the recorded
    change; what no surface looks like (a reflection, grains of a dithered film) leaves most of it unexplained.

    `illumination` None: the calibration contains its own light, and only the direction of the change is compared.
    """
    import cv2

    n, found = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n < 2:
        return touched
    labels = np.asarray(found, np.int32)
    _, cells = changed.patches
    around = _spread_labels(labels, cells)
    change = cells.change * cells.unmarked_share
    net, total, energy = (_sum_regions(a, around, n) for a in (change, np.abs(change), change * change))
    keep = np.abs(net).sum(axis=1) < _ONE_DIRECTION * total.sum(axis=1)
    if illumination is not None:
        rendered = _render_change(surface_mm, cells, changed, illumination)
        residual = np.asarray((cells.change - rendered) * cells.unmarked_share, np.float32)
        unexplained = _sum_regions(residual * residual, around, n).sum(axis=1)
        total_energy = energy.sum(axis=1)
        limit_grey = changed.source.limits.no_contact_change
        weak = total_energy < 3.0 * limit_grey**2 * np.bincount(around.ravel(), minlength=n)
        keep &= unexplained < (1.0 - np.where(weak, _EXPLAINED_MIN_WEAK, _EXPLAINED_MIN)) * total_energy
    keep[0] = False
    return keep[labels]


def _spread_labels(labels: Indices, cells: ImagePatch) -> Indices:
    """Labels (rows, cols) of the regions on the grid of `cells`, each with its surroundings; 0 elsewhere."""
    import cv2

    by = cells.downsampling
    coarse = np.zeros(cells.changed.shape, np.float32)
    rows, cols = np.nonzero(labels)
    np.maximum.at(coarse, (rows // by, cols // by), labels[rows, cols].astype(np.float32))
    width = 2 * max(1, round(_REACH_MM / cells.pixel_mm)) + 1
    spread = np.asarray(cv2.dilate(coarse, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))))
    spread = np.where(coarse > 0, coarse, spread)
    return np.where(cells.changed, spread, 0.0).astype(np.int32)


def _sum_regions(values: Floats, labels: Indices, n: int) -> Doubles:
    """The sums (n, 3) of each colour of `values` (rows, cols, 3) over the `n` regions."""
    where = labels.ravel()
    sums = [np.bincount(where, values[..., c].ravel(), n) for c in range(3)]
    return np.asarray(np.stack(sums, axis=1), np.float64)


def _render_change(surface_mm: Floats, cells: ImagePatch, changed: ChangedImage, illumination: Illumination) -> Floats:
    """The change (rows, cols, 3) in grey levels that a surface of the window shows in its illumination."""
    light = selection.make_light(illumination, cells, changed.source)
    surface = clip_surface(compute_cell_means(surface_mm, cells.downsampling), cells, light)
    rendered = light.render(surface, *compute_slopes(surface, cells.pixel_mm)).change
    return simulate_recorded_change(rendered, cells, light.blur_px)


_FLANK, _FLANK_SHARE = 0.12, 0.1  # mm/mm of a flank, and its least share of a region's pixels
_FLANK_OF_DEEPEST = 0.7  # of the steepest tenth of the deepest region, where a light touch has nothing steeper
_STEP_PX = 7  # extent of a smoothed step, to both sides
_PROMINENCE = 0.5  # of a region's own depth: simulated second touches of 0.05 mm and more have 0.64 to 1.1
_RING_MM = (0.25, 0.8)  # inner and outer distance of the ring that a region is compared with
_BORDER_SHARE = 0.4  # of the deepest region: corners next to a real GelSlim's presses reach 0.36


def remove_false_contacts(
    touched: Mask, surface_mm: Floats, pixel_mm: float, border: Mask | None = None, changed: Mask | None = None
) -> Mask:
    """The contact `touched` (rows, cols) without false regions; the deepest region stays.

    A true region has flanks: some of it is steep, and not where the `changed` part of the image ends, since a surface
    raised by drift ends there in a step. It stands out from its surroundings. At the image `border`, beyond which
    nothing holds the surface, it has a good part of the deepest region's depth: light is least known in the corners.
    """
    import cv2

    n, labels = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n <= 2:  # the background and one region
        return touched
    regions = np.asarray(labels, np.int32)
    depths = np.full(n, -np.inf, np.float32)
    np.maximum.at(depths, regions[touched], surface_mm[touched])
    depths = depths[1:]
    deepest = 1 + int(np.argmax(depths))
    slope = np.asarray(cv2.magnitude(*compute_slopes(surface_mm, pixel_mm)), np.float32)
    steepest = float(percentile(slope, 90.0, regions == deepest))
    steep = np.asarray(slope > min(_FLANK, _FLANK_OF_DEEPEST * steepest), np.bool_)
    if changed is not None:
        steep &= _erode_inside(changed)
    keep = np.bincount(regions[touched & steep], minlength=n) > _FLANK_SHARE * np.bincount(regions.ravel(), minlength=n)
    if border is not None:
        cut = np.unique(regions[touched & border])
        keep[cut[depths[cut - 1] < _BORDER_SHARE * float(depths.max())]] = False
    keep[0] = keep[deepest] = False
    for k in np.flatnonzero(keep):
        keep[k] = _stands_out(np.equal(regions, k), touched, surface_mm, pixel_mm)
    keep[deepest] = True
    return np.asarray(keep[regions], np.bool_)


def _erode_inside(changed: Mask) -> Mask:
    """The pixels (rows, cols) farther from the end of `changed` than a smoothed step; the image border is no end."""
    import cv2

    kernel = np.ones((_STEP_PX, _STEP_PX), np.uint8)
    return np.asarray(cv2.erode(changed.astype(np.uint8), kernel, borderValue=1), np.bool_)


def _stands_out(region: Mask, touched: Mask, surface_mm: Floats, pixel_mm: float) -> bool:
    """Whether a region is deeper than the untouched ring around it by a good part of its depth."""
    import cv2

    near_px, far_px = (max(1, round(mm / pixel_mm)) for mm in _RING_MM)
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    around = far_px + near_px
    here = tuple(slice(max(0, first - around), first + n + around) for first, n in ((top, height), (left, width)))
    ring = _dilate(region[here], far_px) & ~_dilate(touched[here], near_px)
    if not ring.any():
        return True
    depth_mm = median(surface_mm, region)
    return bool(depth_mm - median(surface_mm[here], ring) > _PROMINENCE * depth_mm)


def _dilate(mask: Mask, by_px: int) -> Mask:
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * by_px + 1, 2 * by_px + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc), np.bool_)
