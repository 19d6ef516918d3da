"""Levels a gel's surface: finds where it is at rest and brings it to zero there.

Slopes that are slightly wrong on one flank of a dent leave the gel behind it too high or too low,
and a level face has no slopes that distinguish it from the gel around. Mechanics does: a nearly
incompressible layer of thickness t returns to rest within about t of a load. So quiet patches,
farther than that from any pressure, are either at rest or the inside of a face, and a face is about
as deep as the rim that encloses it. The surface z is brought to zero on the former with the least
bending:

    minimise  sum |grad (z' - z)|^2 + w z'^2,   w > 0 at rest;

the correction is smooth, so it is computed on a coarse grid.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, median
from pipeline.core.frozen import frozen
from pipeline.physics import gel as gel_mechanics
from pipeline.sensors.spec import Gel
from pipeline.stages.depth.contact import (
    downsample,
    reaches_border,
    select_seeded,
    upsample,
)
from pipeline.stages.depth.gel.settings import ContactSettings


@frozen
class LevelledSurface:
    """A surface that is zero at rest, and the faces inside it that cause no colour change."""

    surface_mm: Floats  # (rows, cols)
    face_interior: Mask  # (rows, cols) parts of faces without visible pressure


def level_surface(
    surface_mm: Floats, pressed: Mask, pixel_mm: float, gel: Gel, settings: ContactSettings
) -> LevelledSurface:
    """The surface (rows, cols) with its rest at zero.

    `pressed`: where there certainly is pressure.
    """
    by = max(1, round(max(surface_mm.shape) / settings.coarse_cells))
    z = downsample(surface_mm, by)
    held = downsample(pressed.astype(np.float32), by) > 0
    inside = np.zeros(z.shape, np.bool_)
    reach = settings.quiet_distance * gel.thickness_mm / (pixel_mm * by)
    quiet, patches = _find_quiet_patches(held, reach)
    lowest, relief = _compute_spread(z, settings.lowest_percent)
    rest = quiet.copy()
    level = lowest if held.any() else float(np.median(z))
    if patches:
        levels = [float(np.median(z[patch])) for patch in patches]
        level = min(levels)
        if level - lowest > settings.face_share * relief:
            level = lowest  # all quiet patches are higher than their surroundings
        for patch, own in zip(patches, levels, strict=True):
            deep = _compute_rim_height(z, patch, reach) - level
            share = settings.cut_face_share if reaches_border(patch) else settings.face_share
            if deep > settings.relief_share * relief and own - level > share * deep:
                inside |= patch
        if not inside.any():
            level = min(levels)
        _, spread = _compute_spread(z[quiet], settings.spread_percent)
        if not inside.any() and spread < settings.rest_spread_share * relief:
            return LevelledSurface(surface_mm=surface_mm, face_interior=np.zeros_like(pressed))
        rest &= ~inside
    z = z - np.float32(level)
    added = _solve_correction(z, rest, settings)
    shape = surface_mm.shape
    levelled_mm = surface_mm - np.float32(level) + upsample(added, shape)
    return LevelledSurface(
        surface_mm=levelled_mm,
        face_interior=_extend_to_rim(
            levelled_mm, upsample(inside.astype(np.float32), shape) > 0.5, settings.face_share
        ),
    )


def compute_far_field(
    surface_mm: Floats,
    touched: Mask,
    pixel_mm: float,
    gel: Gel,
    settings: ContactSettings,
    far: Mask | None = None,
) -> tuple[Floats, np.float32]:
    """The layer's surface (rows, cols) in mm around a contact, with its bulge, from mechanics
    alone, and how much higher the contact is than `surface_mm`.

    The surface of least energy through the measured contact, on a coarse grid. A nearly
    incompressible layer rises around a contact, so what looks at rest is not: slopes alone would
    measure the contact from the bulge. So the contact is shifted by what brings the surface in
    `far`, if it is more than a few pixels, to the height that mechanics gives it.
    """
    by = max(1, round(max(surface_mm.shape) / settings.coarse_cells))
    share = downsample(touched.astype(np.float32), by)
    depth = downsample(surface_mm * touched, by) / np.maximum(share, np.float32(1e-6))
    held = share > min(settings.cell_touched, 0.5 * float(share.max()))

    def relax(level: np.float32) -> Floats:
        solution = gel_mechanics.relax_gel(
            gel,
            pixel_mm * by,
            depth + level,
            held,
            tolerance_mm=settings.far_tolerance_mm,
            max_steps=settings.far_iterations,
        )
        return upsample(solution.indentation_mm, surface_mm.shape)

    beyond = relax(np.float32(0.0))
    if far is None or np.count_nonzero(far) <= settings.far_share_min * far.size:
        return beyond, np.float32(0.0)
    shift = median(beyond, far) - median(surface_mm, far)
    return relax(shift), shift


def _extend_to_rim(surface_mm: Floats, inside: Mask, share: float) -> Mask:
    """The face that a patch of its inside belongs to: everything connected to it that is about
    as deep.
    """
    if not inside.any():
        return inside
    level = surface_mm > share * float(np.median(surface_mm[inside]))
    return select_seeded(level | inside, inside, 4)


def _find_quiet_patches(held: Mask, reach: float) -> tuple[Mask, list[Mask]]:
    """Cells farther than `reach` cells from any pressure, and their connected patches."""
    import cv2

    if not held.any():
        return np.ones_like(held), []
    away = cv2.distanceTransform((~held).astype(np.uint8), cv2.DIST_L2, 5)
    quiet = np.asarray(away > reach, np.bool_)
    n, labels = cv2.connectedComponents(quiet.astype(np.uint8), connectivity=4)
    return quiet, [np.asarray(labels == k, np.bool_) for k in range(1, n)]


def _compute_spread(values: Floats, percent: float) -> tuple[float, float]:
    """(lowest, range) of the values without this many percent at either end."""
    low, high = np.percentile(values, (percent, 100.0 - percent))
    return float(low), float(high) - float(low)


def _compute_rim_height(z: Floats, patch: Mask, reach: float) -> float:
    """Depth of the rim around a patch: the median of the deepest cells near its outline."""
    import cv2

    width = 2 * math.ceil(2.0 * reach) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    inner = np.asarray(
        cv2.erode(patch.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1), np.bool_
    )
    return float(np.median(np.asarray(cv2.dilate(z, disc))[patch & ~inner]))


def _solve_correction(z: Floats, rest: Mask, settings: ContactSettings) -> Floats:
    """The correction d of the coarse surface: (laplacian + w) d = -w z by preconditioned
    conjugate gradients.
    """
    from scipy import fft

    if not rest.any():
        return np.zeros_like(z)
    weight = settings.rest_weight * rest.astype(np.float64)
    rows, cols = z.shape
    ky, kx = (np.arange(n) * (math.pi / (2 * n)) for n in (rows, cols))
    symbol = 4.0 * np.sin(ky)[:, None] ** 2 + 4.0 * np.sin(kx)[None, :] ** 2
    inverse = 1.0 / (symbol + float(weight.mean()))

    def apply_preconditioner(a: Doubles) -> Doubles:
        return np.asarray(fft.idctn(fft.dctn(a, norm="ortho") * inverse, norm="ortho"), np.float64)

    d: Doubles = np.zeros(z.shape)
    left = -weight * z.astype(np.float64)
    step = np.zeros_like(d)
    energy = 1.0
    first = float(np.abs(left).max())
    for k in range(settings.iterations):
        if float(np.abs(left).max()) <= settings.tolerance * first:
            break
        ready = apply_preconditioner(left)
        new = float((left * ready).sum())
        step = ready + (new / energy if k else 0.0) * step
        moved = _laplacian(step) + weight * step
        length = new / float((step * moved).sum())
        d = d + length * step
        left = left - length * moved
        energy = new
    return d.astype(np.float32)


def _laplacian(a: Doubles) -> Doubles:
    """The negated five-point Laplacian, mirrored at the border."""
    import cv2

    return -np.asarray(
        cv2.Laplacian(a, cv2.CV_64F, ksize=1, borderType=cv2.BORDER_REFLECT), np.float64
    )
