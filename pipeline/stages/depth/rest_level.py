"""Where a pressed gel is at rest, and its surface brought to it.

Slopes that are a little wrong on one flank of a dent leave the gel beyond it too high or too low, and a level face has
no slopes at all to tell it from the gel around. Mechanics tells: a nearly incompressible layer of thickness t falls to
its rest within about t of what presses. So what is quiet, farther than that from any pressure, is in patches that are
either at rest or the inside of a face, and a face is about as deep as the rim that encloses it. The surface z is
brought to zero on the first, and as little bent as that asks:

    minimise  sum |grad (z' - z)|^2 + w z'^2,   w > 0 at rest;

what is added is smooth, so that it is looked for on a coarse grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask
from pipeline.base.ranks import median
from pipeline.physics import gel as gel_mechanics
from pipeline.sensors.spec import Gel

_CELLS = 56  # of the coarse grid along the longer side
_QUIET_FROM = 0.7  # thicknesses from what presses
_FACE_SHARE = 0.7  # of the rim's depth: a patch that deep, which a rim encloses, is the inside of a face
_OPEN_SHARE = 0.87  # the same for one that the picture's border cuts: slopes that are a little wrong lift it as well
_FACE_RELIEF = 0.3  # of the whole relief, that a face's rim is deep at least
_LOWEST = 2.0  # percentile of a surface that stands for its lowest part: a bulge, or what lies beside a face
_AT_REST = 0.2  # of the whole relief: what is quiet and lies no farther apart is at rest as it is
_LOW, _HIGH = 5.0, 95.0  # percentiles that it lies between: a patch counts by its size
_HELD = 0.3  # weight w of a cell at rest beside one step of the surface between two cells
_STEPS = 24
_EXACT = 1e-3
_CELL_TOUCHED = 0.5  # share of a cell
_FEWEST_FAR = 0.02  # of the pixels, that tell a level
_FAR_MM, _FAR_STEPS = 2e-3, 12  # how exact the far field is: micrometres of what is a tenth of a millimetre


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelledSurface:
    """A surface whose rest is zero, and what it tells of the part of the image that no light told of."""

    surface_mm: Floats  # (rows, cols)
    face_interior: Mask  # (rows, cols) patches without pressure that belong to a face


def level_surface(surface_mm: Floats, pressed: Mask, pixel_mm: float, gel: Gel) -> LevelledSurface:
    """The surface (rows, cols) with its rest at zero; `pressed` is where anything certainly presses."""
    by = max(1, round(max(surface_mm.shape) / _CELLS))
    z, held = downsample(surface_mm, by), downsample(pressed.astype(np.float32), by) > 0
    inside = np.zeros(z.shape, np.bool_)
    reach = _QUIET_FROM * gel.thickness_mm / (pixel_mm * by)
    quiet, patches = _quiet(held, reach)
    lowest, highest = (float(v) for v in np.percentile(z, (_LOWEST, 100.0 - _LOWEST)))
    rest, level = quiet.copy(), (lowest if held.any() else float(np.median(z)))
    if patches:
        levels = [float(np.median(z[patch])) for patch in patches]
        level = min(levels)
        if level - lowest > _FACE_SHARE * (highest - lowest):
            level = lowest  # all that is quiet lies higher than what surrounds it
        for patch, own in zip(patches, levels, strict=True):
            deep = _rim(z, patch, reach) - level
            share = _OPEN_SHARE if _is_cut(patch) else _FACE_SHARE
            if deep > _FACE_RELIEF * (highest - lowest) and own - level > share * deep:
                inside |= patch
        if not inside.any():
            level = min(levels)
        if not inside.any() and _spread(z[quiet]) < _AT_REST * (highest - lowest):
            return LevelledSurface(surface_mm=surface_mm, face_interior=np.zeros_like(pressed))
        rest &= ~inside
    z = z - np.float32(level)
    added = _brought(z, rest)
    shape = surface_mm.shape
    settled_mm = surface_mm - np.float32(level) + upsample(added, shape)
    return LevelledSurface(
        surface_mm=settled_mm,
        face_interior=_up_to_its_rim(settled_mm, upsample(inside.astype(np.float32), shape) > 0.5),
    )


def compute_far_field(surface_mm: Floats, touched: Mask, pixel_mm: float, gel: Gel) -> Floats:
    """How the layer lies (rows, cols) in mm around what presses, from mechanics alone: bulge and all.

    The surface of least energy that passes through the touched part as it was measured, on a coarse grid.
    """
    by = max(1, round(max(surface_mm.shape) / _CELLS))
    share = downsample(touched.astype(np.float32), by)
    depth = downsample(np.where(touched, surface_mm, np.float32(0.0)), by) / np.maximum(share, np.float32(1e-6))
    held = share > min(_CELL_TOUCHED, 0.5 * float(share.max()))
    return upsample(_relaxed(np.asarray(depth, np.float32), held, pixel_mm * by, gel), surface_mm.shape)


def level_by_far_field(surface_mm: Floats, touched: Mask, far: Mask, pixel_mm: float, gel: Gel) -> Floats:
    """The surface (rows, cols) whose `far` part lies as high as mechanics have it beside the contact.

    What a nearly incompressible layer is pressed out of rises around the contact, so that what looks at rest is not:
    slopes alone would measure the contact from the bulge. Where too little lies far away to tell, it stays as it is.
    """
    if np.count_nonzero(far) <= _FEWEST_FAR * far.size:
        return surface_mm
    beyond = compute_far_field(surface_mm, touched, pixel_mm, gel)
    return surface_mm + np.float32(median(beyond, far) - median(surface_mm, far))


def _relaxed(depth_mm: Floats, held: Mask, cell_mm: float, gel: Gel) -> Floats:
    found = gel_mechanics.relax_gel(gel, cell_mm, depth_mm, held, tolerance_mm=_FAR_MM, max_steps=_FAR_STEPS)
    return found.indentation_mm


def _up_to_its_rim(surface_mm: Floats, inside: Mask) -> Mask:
    """The face that a patch of its inside belongs to: all around it that is about as deep."""
    import cv2

    if not inside.any():
        return inside
    level = surface_mm > _FACE_SHARE * float(np.median(surface_mm[inside]))
    n, found = cv2.connectedComponents((level | inside).astype(np.uint8), connectivity=4)
    labels = np.asarray(found, np.int32)
    joined = np.zeros(n, np.bool_)
    joined[np.unique(labels[inside])] = True
    return np.asarray(joined[labels], np.bool_)


def _quiet(held: Mask, reach: float) -> tuple[Mask, list[Mask]]:
    """Cells farther than `reach` cells from any pressure, and their connected patches."""
    import cv2

    if not held.any():
        return np.ones_like(held), []
    away = cv2.distanceTransform((~held).astype(np.uint8), cv2.DIST_L2, 5)
    quiet = np.asarray(away > reach, np.bool_)
    n, labels = cv2.connectedComponents(quiet.astype(np.uint8), connectivity=4)
    return quiet, [np.asarray(labels == k, np.bool_) for k in range(1, n)]


def _spread(values: Floats) -> float:
    low, high = np.percentile(values, (_LOW, _HIGH))
    return float(high - low)


def _is_cut(patch: Mask) -> bool:
    """Whether the picture's border cuts a patch."""
    return bool(patch[0].any() or patch[-1].any() or patch[:, 0].any() or patch[:, -1].any())


def _rim(z: Floats, patch: Mask, reach: float) -> float:
    """How deep the ridge is, of what presses around a patch: the usual depth of the deepest cells near its end."""
    import cv2

    width = 2 * math.ceil(2.0 * reach) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    inner = np.asarray(cv2.erode(patch.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1), np.bool_)
    return float(np.median(np.asarray(cv2.dilate(z, disc))[patch & ~inner]))


def _brought(z: Floats, rest: Mask) -> Floats:
    """What to add to the coarse surface: conjugate gradients on (laplacian + w) d = -w z, helped by cosines."""
    from scipy import fft

    if not rest.any():
        return np.zeros_like(z)
    weight = _HELD * rest.astype(np.float64)
    rows, cols = z.shape
    ky, kx = (np.arange(n) * (math.pi / (2 * n)) for n in (rows, cols))
    symbol = 4.0 * np.sin(ky)[:, None] ** 2 + 4.0 * np.sin(kx)[None, :] ** 2
    inverse = 1.0 / (symbol + float(weight.mean()))

    def apply_preconditioner(a: Doubles) -> Doubles:
        return np.asarray(fft.idctn(fft.dctn(a, norm="ortho") * inverse, norm="ortho"), np.float64)

    d: Doubles = np.zeros(z.shape)
    left = -weight * z.astype(np.float64)
    step, energy, first = np.zeros_like(d), 1.0, float(np.abs(left).max())
    for k in range(_STEPS):
        if float(np.abs(left).max()) <= _EXACT * first:
            break
        ready = apply_preconditioner(left)
        new = float((left * ready).sum())
        step = ready + (new / energy if k else 0.0) * step
        moved = _laplacian(step) + weight * step
        length = new / float((step * moved).sum())
        d, left, energy = d + length * step, left - length * moved, new
    return d.astype(np.float32)


def _laplacian(a: Doubles) -> Doubles:
    """Of five points, mirrored at the border, positive."""
    out = np.zeros_like(a)
    out[1:] += a[1:] - a[:-1]
    out[:-1] += a[:-1] - a[1:]
    out[:, 1:] += a[:, 1:] - a[:, :-1]
    out[:, :-1] += a[:, :-1] - a[:, 1:]
    return out


def downsample(image: Floats, by: int) -> Floats:
    """Means of an image (rows, cols) over cells of `by` x `by` pixels, about; the last of a row may be narrower."""
    import cv2

    size = (-(-image.shape[1] // by), -(-image.shape[0] // by))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def upsample(image: Floats, shape: tuple[int, ...]) -> Floats:
    """An image of `coarse` at `shape` (rows, cols)."""
    import cv2

    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)
