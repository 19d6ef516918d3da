"""Contact of a gel or membrane, from its indentation.

A surface moves outside the contact too (Hertz: at its edge by half of the largest indentation, on a
thin bonded layer by less), so no limit on depth separates touched from moved. Pressure does: it is
zero outside. A pressure wave of wavenumber q moves an elastic half-space by U(q) = 2 P(q) / (E* q),
hence P(q) ~ q U(q), which is no rougher than a slope, and dimensionless where U is in mm. A layer
bonded to a plate responds in the same way except to waves longer than its thickness; neglecting
that shifts the pressure by a smooth amount, and neither the thickness nor the stiffness of the gel
is needed.

The estimated pressure is blurred. That of a ball falls like a square root, which a blur hardly
moves; below a sharp rim it is nearly infinite and spreads by the width of the blur, over the
adjacent wall as well. So the limit is a share of the peak nearby, a larger one where that peak is
far above the median of the contact, as below a rim. Far from any peak the limit is a share of the
median, not of the region's peak: a cone's is infinite at its tip, and 0.16 of it would lose a
quarter of the cone.

The share of the median pressure and the rule for hanging gel are for real gels: the pressure of
balls on them extends beyond their contact, and these two end it near their visible rim.
"""

import math
from typing import Literal

import numpy as np

from pipeline.core.arrays import Floats, Indices, Mask, freeze, percentile
from pipeline.core.derived import derive_once
from pipeline.physics.optics import compute_slopes
from pipeline.stages.depth.gel.settings import ContactSettings
from pipeline.stages.depth.poisson import count_workers


def compute_relative_pressure(
    indentation_mm: Floats, smoothing_px: float, order: Literal[1, 2] = 1
) -> Floats:
    """Pressure (rows, cols) up to a constant factor and a smooth offset.

    Negative where the surface hangs free.

    `order` is the power of the wavenumber: 1 for an elastic gel, 2 for a membrane under tension,
    which carries load by its curvature alone. The image is mirrored at its border (cosine
    transform).
    """
    from scipy import fft

    rows, cols = indentation_mm.shape
    workers = count_workers(rows * cols)
    wave = np.asarray(fft.dctn(indentation_mm, type=2, norm="ortho", workers=workers))
    wave *= _compute_wavenumbers(rows, cols, smoothing_px, order)
    return np.asarray(
        fft.idctn(wave, type=2, norm="ortho", workers=workers, overwrite_x=True), np.float32
    )


def detect_contact(
    indentation_mm: Floats,
    pixel_mm: float,
    *,
    least_mm: float,
    pressure_share: float,
    settings: ContactSettings,
) -> Mask:
    """Contact of a gel (rows, cols): indented by `least_mm` or more, with more pressure than a
    share of that nearby.

    An image's blur spreads pressure no farther than its own width, so only the peak within that
    counts: a cone's rim is in contact whatever its tip does, and the pressure of a sharp edge does
    not widen the contact. Shallow gel close to a deep point hangs free: a ball's contact on real
    gels ends where it is about a third as deep. A part in which no pixel reaches a share of its
    region's peak pressure is left out.
    """
    deep = indentation_mm > least_mm
    if not deep.any():
        return deep
    pressure = compute_relative_pressure(indentation_mm, settings.smoothing_px)
    pressure /= np.float32(pixel_mm)
    pressure[~deep | _find_hanging(indentation_mm, pixel_mm, settings)] = 0.0
    touched = np.zeros_like(deep)
    here = find_box(deep, settings.box_margin_px)
    deep_here = np.ascontiguousarray(deep[here])
    pressed, sure = _compare_with_nearby(
        pressure[here],
        deep_here,
        pixel_mm,
        pressure_share,
        settings,
    )
    seeded = select_seeded(pressed, sure)
    touched[here] = _add_faces(indentation_mm[here], seeded, deep_here, settings)
    return touched


def _find_hanging(indentation_mm: Floats, pixel_mm: float, settings: ContactSettings) -> Mask:
    """The gel (rows, cols) that is far shallower than a point close by."""
    import cv2

    cells = settings.hanging_cells
    by = max(1, round(settings.hanging_mm / pixel_mm / cells))
    around = np.ones((2 * cells + 1, 2 * cells + 1), np.uint8)
    deepest = np.asarray(cv2.dilate(downsample(indentation_mm, by), around), np.float32)
    return indentation_mm < settings.hanging_share * upsample(deepest, indentation_mm.shape)


def reaches_border(mask: Mask) -> bool:
    """Whether a mask (rows, cols) reaches the border of the image."""
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())


def find_box(mask: Mask, margin: int) -> tuple[slice, slice]:
    """The rows and columns that hold all of a mask (rows, cols), with a margin."""
    row, col = (
        slice(max(0, int(at[0]) - margin), min(n, int(at[-1]) + margin + 1))
        for at, n in zip(
            (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0)), mask.shape, strict=True
        )
    )
    return row, col


def _compare_with_nearby(
    pressure: Floats,
    deep: Mask,
    pixel_mm: float,
    pressure_share: float,
    settings: ContactSettings,
) -> tuple[Mask, Mask]:
    """The pixels (rows, cols) of `deep` with enough pressure, and those of them with a part of
    their region's peak.
    """
    import cv2

    reach = 2 * max(1, round(settings.near_mm / pixel_mm)) + 1
    dilated = cv2.dilate(pressure, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    found, n = _label_regions(deep)
    at = np.flatnonzero(deep)  # the rest is on these pixels alone, each array (n,)
    own, near = (np.asarray(a, np.float32).reshape(-1)[at] for a in (pressure, dilated))
    region = found.reshape(-1)[at]
    peak = _find_peaks(own, region, n)[region]
    least = settings.pressure_min
    core = own > np.maximum(np.maximum(least, pressure_share * near), settings.core_share * peak)
    median = _compute_medians(own[core], region[core], n)[region]
    low, high = settings.ridge_ratios
    ridge = np.clip((near / np.maximum(median, least) - low) / (high - low), 0.0, 1.0)
    share = pressure_share + np.maximum(settings.ridge_share - pressure_share, 0.0) * ridge
    limit = np.maximum(np.maximum(least, settings.median_share * median), share * near)
    enough = own > limit
    pressed = np.zeros_like(deep)
    sure = np.zeros_like(deep)
    pressed.reshape(-1)[at] = enough
    sure.reshape(-1)[at] = enough & (own > settings.part_share * peak)
    return pressed, sure


def detect_membrane_contact(
    indentation_mm: Floats, *, least_mm: float, pressure_share: float, smoothing_px: float
) -> Mask:
    """Contact of a membrane (rows, cols): indented, with more load than a share of its region's
    peak; without holes.

    Each indented region has its own peak, so a light touch next to a firm one is kept.
    """
    deep = indentation_mm > least_mm
    if not deep.any():
        return deep
    load = compute_relative_pressure(indentation_mm, smoothing_px, 2)
    regions, n = _label_regions(deep)
    peak = np.maximum(_find_peaks(load[deep], regions[deep], n), np.float32(1e-9))
    mask = deep & (load > peak[regions] * np.float32(pressure_share))
    return fill_holes(np.asarray(mask, np.bool_))


def _label_regions(mask: Mask, connectivity: int = 8) -> tuple[Indices, int]:
    """Labels (rows, cols) of connected regions, 0 outside the mask, and the number of labels."""
    import cv2

    n, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)
    return np.asarray(labels, np.int32), int(n)


def _find_peaks(values: Floats, region: Indices, n: int) -> Floats:
    """The largest of the values (m,) in each of `n` regions; 0 where it is negative."""
    peaks = np.zeros(n, np.float32)
    np.maximum.at(peaks, region, values)
    return peaks


def _compute_medians(values: Floats, region: Indices, n: int) -> Floats:
    """The upper median of the values (m,) in each of `n` regions; 0 in an empty one."""
    order = np.argsort(region.astype(np.min_scalar_type(n)), kind="stable")
    ends = np.cumsum(np.bincount(region, minlength=n))[:-1]
    medians = np.zeros(n, np.float32)
    for k, own in enumerate(np.split(values[order], ends)):
        if len(own):
            medians[k] = np.partition(own, len(own) // 2)[len(own) // 2]
    return medians


def select_seeded(mask: Mask, seeds: Mask, connectivity: int = 8) -> Mask:
    """The connected parts of `mask` that contain a seed."""
    regions, n = _label_regions(mask, connectivity)
    keep = np.zeros(n, np.bool_)
    keep[regions[mask & seeds]] = True
    return np.take(keep, regions)


def _add_faces(
    indentation_mm: Floats, pressed: Mask, deep: Mask, settings: ContactSettings
) -> Mask:
    """The contact with the inside of flat faces, where hardly any pressure shows.

    A flat face carries its pressure along its rim. Its inside is as deep as the rim and level,
    unlike the gel around a contact, which falls away at once.
    """
    import cv2

    if not pressed.any():
        return pressed
    smooth = np.asarray(cv2.GaussianBlur(indentation_mm, (0, 0), settings.smoothing_px), np.float32)
    slope = np.asarray(cv2.magnitude(*compute_slopes(smooth, 1.0)), np.float32)
    _, nearest = cv2.distanceTransformWithLabels(
        (~pressed).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = np.asarray(nearest, np.int32)
    depth_of = np.zeros(int(labels.max()) + 1, np.float32)
    depth_of[labels[pressed]] = indentation_mm[pressed]
    steep = float(percentile(slope, 95.0, deep))
    level = deep & ~pressed & (slope < settings.flat_slope_share * steep)
    level &= indentation_mm >= settings.flat_depth_share * np.take(depth_of, labels)
    joined = select_seeded(level | pressed, pressed, 4).astype(np.uint8)
    # A line of pixels between the rim's pressure ridge and the face belongs to neither.
    step = (settings.step_px, settings.step_px)
    closed = cv2.morphologyEx(
        joined, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, step)
    )
    return np.asarray(closed, np.bool_) & deep


def fill_holes(mask: Mask) -> Mask:
    """The mask (rows, cols) with its holes filled: pixels without a 4-connected path to the image
    border.

    Same as scipy's `binary_fill_holes`, whose package takes a third of a second to load.
    """
    regions, _ = _label_regions(np.pad(~mask, 1, constant_values=True), 4)
    return np.asarray(regions[1:-1, 1:-1] != regions[0, 0], np.bool_)


def fill_small_holes(mask: Mask, max_pixels: int) -> Mask:
    """The mask (rows, cols) with holes of at most `max_pixels` pixels filled."""
    holes = fill_holes(mask) & ~mask
    if not holes.any():
        return mask
    regions, n = _label_regions(holes, 4)
    small = np.bincount(regions[holes], minlength=n) <= max_pixels
    small[0] = False
    return mask | np.take(small, regions)


def remove_specks(mask: Mask, min_pixels: int, min_share: float = 0.05) -> Mask:
    """The mask without regions of fewer than `min_pixels` pixels or a share of the largest region:
    dust and scratches that the press has shifted.
    """
    regions, n = _label_regions(mask)
    areas = np.bincount(regions[mask], minlength=n)
    keep = areas >= max(min_pixels, min_share * int(areas.max()))
    return mask if keep[1:].all() else np.take(keep, regions)


def remove_weak_specks(mask: Mask, pressure: Floats, min_pixels: float, peak_share: float) -> Mask:
    """The mask (rows, cols) without regions of fewer than `min_pixels` pixels and little pressure:
    specks of noise.

    A region that reaches `peak_share` of the largest `pressure` (rows, cols) stays however small it
    is: only pieces of a light touch's rim are visible.
    """
    regions, n = _label_regions(mask)
    keep = np.bincount(regions[mask], minlength=n) >= min_pixels
    keep[regions[mask & (pressure >= peak_share * float(pressure.max()))]] = True
    return np.take(keep, regions)


def downsample(image: Floats, by: int) -> Floats:
    """Means of an image (rows, cols) over cells of about `by` x `by` pixels."""
    import cv2

    size = (-(-image.shape[1] // by), -(-image.shape[0] // by))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def upsample(image: Floats, shape: tuple[int, ...]) -> Floats:
    """A coarse image interpolated to `shape` (rows, cols)."""
    import cv2

    return np.asarray(
        cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32
    )


@derive_once
def _compute_wavenumbers(rows: int, cols: int, smoothing_px: float, order: Literal[1, 2]) -> Floats:
    """Wavenumbers (rows, cols) of a cosine transform to the power of `order`, radians per pixel,
    damped by a blur.
    """
    ky, kx = (np.arange(n) * (math.pi / n) for n in (rows, cols))
    q_sq = ky[:, None] ** 2 + kx[None, :] ** 2
    blurs = [np.exp(-0.5 * (smoothing_px * k) ** 2) for k in (ky, kx)]
    return freeze(
        ((np.sqrt(q_sq) if order == 1 else q_sq) * blurs[0][:, None] * blurs[1]).astype(np.float32)
    )
