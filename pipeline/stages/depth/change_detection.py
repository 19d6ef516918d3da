"""Where a gel's image differs from its reference, and the window in which the surface is
estimated.
"""

import numpy as np

from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.frozen import frozen
from pipeline.stages.depth.contact import fill_holes
from pipeline.stages.depth.gel.coarse_light import compute_block_means
from pipeline.stages.depth.gel.settings import SLOPES


@frozen
class ImageWindow:
    """The part of the image in which the surface is estimated."""

    rows: slice
    cols: slice
    changed: Mask  # (rows, cols) of the window: where the surface is estimated
    # (rows, cols) weight of the surface: 1, falling to 0 at the end of `changed`
    blend_weight: Floats


def compute_block_change(image: Image, reference: Image, block_px: int) -> Image:
    """Mean absolute change of every whole block (rows // block, cols // block, 3), rounded.

    The last few pixels are dropped.
    """
    import cv2

    rows, cols = (n // block_px for n in image.shape[:2])
    change = cv2.absdiff(image, reference)
    if rows and cols:  # else smaller than a block
        change = change[: rows * block_px, : cols * block_px]
    return np.asarray(
        cv2.resize(change, (max(1, cols), max(1, rows)), interpolation=cv2.INTER_AREA), np.uint8
    )


def detect_change(
    image: Image, reference: Image, no_touch_grey: float, pixel_mm: float
) -> ImageWindow | None:
    """The window around all changes, with a margin for the gel's relaxation.

    None without a change above noise.

    Some block and its neighbours must have changed together by more than noise does.
    """
    import cv2

    blocks = compute_block_change(image, reference, SLOPES.block_px).max(axis=2).astype(np.float32)
    # A touched region does not extend into changes that the whole image has (drift of the light).
    low = max(
        SLOPES.low_share * no_touch_grey,
        SLOPES.drift_factor * float(np.quantile(blocks, SLOPES.typical_quantile)),
    )
    if float(blocks.max()) < low:  # all of it has changed equally: a touch larger than the image
        low = no_touch_grey
    relative = _compare_with_noise(image, reference, blocks.shape)
    n, regions = cv2.connectedComponents((blocks > low).astype(np.uint8), connectivity=8)
    strong = np.zeros(n, np.bool_)
    strong[np.unique(regions[blocks >= max(no_touch_grey, low)])] = True
    strong[0] = False
    if not (strong[regions] & (relative >= 1.0)).any():
        return None
    # A flat face changes no colours, but is indented: what a touch encloses belongs to it.
    touched = fill_holes(strong[regions])
    return grow_to_window(touched, image.shape[:2], pixel_mm)


def detect_press(
    image: Image,
    reference: Image,
    no_touch_grey: float,
    pixel_mm: float,
    dent_mm: Floats,
) -> ImageWindow:
    """The window of a press: around its changes, or, where none stands out, around its coarse
    dent (rows, cols).
    """
    import cv2

    window = detect_change(image, reference, no_touch_grey, pixel_mm)
    if window is not None:
        return window
    blocks = tuple(max(1, n // SLOPES.block_px) for n in image.shape[1::-1])
    dent = np.asarray(cv2.resize(dent_mm, blocks, interpolation=cv2.INTER_LINEAR))
    return grow_to_window(dent >= SLOPES.dent_share * dent.max(), image.shape[:2], pixel_mm)


def _compare_with_noise(image: Image, reference: Image, shape: tuple[int, ...]) -> Floats:
    """Smoothed change of every block over the noise limit, (rows // 8, cols // 8) = `shape`.

    1 or more is no noise.

    Dither and strong compression make grains of many pixels that a block does not average out.
    Noise is estimated from second differences of neighbouring blocks, to which smooth changes (a
    touch, drift) do not contribute. A small image is divided into smaller blocks, between which a
    touch is still smooth.
    """
    import cv2

    if min(shape) < 3:
        return np.full(shape, np.inf, np.float32)
    block_px = max(1, min(SLOPES.block_px, max(image.shape[:2]) // SLOPES.blocks_min))
    change = compute_block_means(image, block_px) - compute_block_means(reference, block_px)
    smooth = np.asarray(cv2.GaussianBlur(change, (0, 0), SLOPES.smoothing_blocks), np.float32)
    second_differences = np.abs(smooth[:, 2:] - 2.0 * smooth[:, 1:-1] + smooth[:, :-2])
    noise = 1.48 * float(
        np.median(second_differences)
    )  # standard deviation of a Gaussian from its median absolute value
    above = np.abs(smooth).max(axis=2) / np.float32(max(SLOPES.noise_factor * noise, 1e-6))
    return (
        above
        if above.shape == shape
        else np.asarray(cv2.resize(above, shape[::-1], interpolation=cv2.INTER_LINEAR))
    )


def grow_to_window(touched: Mask, shape: tuple[int, ...], pixel_mm: float) -> ImageWindow:
    """The window around the changed blocks (rows // 8, cols // 8) with its margin.

    The margin follows the interpolated distance to the blocks, so it has no steps.
    """
    import cv2

    rows, cols = shape[:2]
    away = (
        np.asarray(cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5), np.float32)
        * SLOPES.block_px
    )
    tall = touched.shape[0] * SLOPES.block_px
    wide = touched.shape[1] * SLOPES.block_px
    full = np.asarray(cv2.resize(away, (wide, tall), interpolation=cv2.INTER_LINEAR), np.float32)[
        :rows, :cols
    ]
    full = np.pad(full, ((0, max(0, rows - tall)), (0, max(0, cols - wide))), "edge")
    left = np.clip(
        (SLOPES.margin_mm / pixel_mm - full)
        * np.float32(pixel_mm / (SLOPES.blend_share * SLOPES.margin_mm)),
        0.0,
        1.0,
    )
    moved = fill_holes(left > 0)
    left[moved & (left <= 0)] = 1.0
    r = np.flatnonzero(moved.any(axis=1))
    c = np.flatnonzero(moved.any(axis=0))
    box = (
        _extend_to_fast_length(int(r[0]) - SLOPES.block_px, int(r[-1]) + SLOPES.block_px + 1, rows),
        _extend_to_fast_length(int(c[0]) - SLOPES.block_px, int(c[-1]) + SLOPES.block_px + 1, cols),
    )
    blend_weight = left[box] * left[box] * (3 - 2 * left[box])
    return ImageWindow(
        rows=box[0],
        cols=box[1],
        changed=np.ascontiguousarray(moved[box]),
        blend_weight=np.ascontiguousarray(blend_weight, np.float32),
    )


def _extend_to_fast_length(low: int, high: int, n: int) -> slice:
    """The pixels `low` to `high` of `n`, extended by a few to a length with a fast transform."""
    from scipy import fft

    low = max(0, low)
    high = min(n, high)
    more = int(fft.next_fast_len(high - low, real=True) or 0) - (high - low)
    after = min(more, n - high)
    before = min(more - after, low)
    # Reaching the image border would change the boundary condition: its last pixel stays outside.
    after -= after > 0 and high + after == n
    before -= before > 0 and low - before == 0
    return slice(low - before, high + after)
