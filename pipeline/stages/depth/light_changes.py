"""Changes of the light that look like a contact: glints, spots, dithering."""

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Indices, Mask
from pipeline.physics.optics import compute_slopes
from pipeline.stages.depth.gel.slopes import ChangedImage
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import (
    Illumination,
    ImagePatch,
    compute_cell_means,
    simulate_recorded_change,
)
from pipeline.stages.depth.illumination.surface_refinement import clip_surface

_REACH_MM = 0.8  # around a region: the flanks of a dent lie partly outside its contact
# Measured over the touches of `benchmarks/real_depth.py`, `real_things.py` and `drift.py`: balls
# have at most 0.6 of their change in one direction, other objects 0.83, spots of light from 0.94
# on.
_ONE_DIRECTION = 0.85
# Share of the squared change that the surface explains. Weak touches (below the sensor's limit of a
# change without contact, root mean square): from 0.4 on, glints 0.2, a dithered film up to 0.35.
# Strong touches in unknown light may have 0.04; strong glints have less than none, -0.2 to -0.6.
_EXPLAINED_MIN_WEAK = 0.36
_EXPLAINED_MIN = 0.0


def remove_light_changes(
    touched: Mask, surface_mm: Floats, changed: ChangedImage, illumination: Illumination | None
) -> Mask:
    """The contact `touched` (rows, cols) of the window without those of its regions that are
    changes of the light.

    Glints, spots of stray light, dithering: a touch is a dent, and a dent explains what is visible
    of it in two ways. Its flanks face opposite LEDs, so each colour rises on one flank and falls on
    the other; a spot of light changes the whole region in one direction. And the dent, rendered in
    the light that it was measured by, looks like the recorded change; what no surface looks like (a
    reflection, grains of a dithered film) leaves most of it unexplained.

    `illumination` None: the calibration contains its own light, and only the direction of the
    change is compared. A single region is a touch, as that of the whole change has been decided,
    and so are all where none looks like one.
    """
    import cv2

    n, found = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n < 3:  # the background and one region
        return touched
    labels = np.asarray(found, np.int32)
    _, cells = changed.patches
    around = _spread_labels(labels, cells)
    change = cells.change * cells.unmarked_share
    net, total, energy = (
        _sum_regions(a, around, n) for a in (change, np.abs(change), change * change)
    )
    keep = np.abs(net).sum(axis=1) < _ONE_DIRECTION * total.sum(axis=1)
    if illumination is not None:
        rendered = _render_change(surface_mm, cells, changed, illumination)
        residual = np.asarray((cells.change - rendered) * cells.unmarked_share, np.float32)
        unexplained = _sum_regions(residual * residual, around, n).sum(axis=1)
        total_energy = energy.sum(axis=1)
        limit_grey = changed.source.limits.no_contact_change
        weak = total_energy < 3.0 * limit_grey**2 * np.bincount(around.ravel(), minlength=n)
        keep &= (
            unexplained < (1.0 - np.where(weak, _EXPLAINED_MIN_WEAK, _EXPLAINED_MIN)) * total_energy
        )
    keep[0] = False
    return keep[labels] if keep.any() else touched


def _spread_labels(labels: Indices, cells: ImagePatch) -> Indices:
    """Labels (rows, cols) of the regions on the grid of `cells`, each with its surroundings.

    0 elsewhere.
    """
    import cv2

    by = cells.downsampling
    coarse = np.zeros(cells.changed.shape, np.float32)
    rows, cols = np.nonzero(labels)
    np.maximum.at(coarse, (rows // by, cols // by), labels[rows, cols].astype(np.float32))
    width = 2 * max(1, round(_REACH_MM / cells.pixel_mm)) + 1
    spread = np.asarray(
        cv2.dilate(coarse, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)))
    )
    spread = np.where(coarse > 0, coarse, spread)
    return np.where(cells.changed, spread, 0.0).astype(np.int32)


def _sum_regions(values: Floats, labels: Indices, n: int) -> Doubles:
    """The sums (n, 3) of each colour of `values` (rows, cols, 3) over the `n` regions."""
    where = labels.ravel()
    sums = [np.bincount(where, values[..., c].ravel(), n) for c in range(3)]
    return np.asarray(np.stack(sums, axis=1), np.float64)


def _render_change(
    surface_mm: Floats, cells: ImagePatch, changed: ChangedImage, illumination: Illumination
) -> Floats:
    """The change (rows, cols, 3) in grey levels that a surface of the window shows in its
    illumination.
    """
    light = selection.make_light(illumination, cells, changed.source)
    surface = clip_surface(compute_cell_means(surface_mm, cells.downsampling), cells, light)
    rendered = light.render(surface, *compute_slopes(surface, cells.pixel_mm)).change
    return simulate_recorded_change(rendered, cells, light.blur_px)
