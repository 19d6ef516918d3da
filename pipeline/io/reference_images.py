"""Images of a gel without contact: with less noise, or replaced by a later frame.

The noise of one reference image enters every comparison; the median of a dozen has a third of it.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.errors import FileProblem, StageWarning

T = TypeVar("T")
A = TypeVar("A", bound=NDArray[np.generic])

_MAX_FRAMES = 15
_MAX_PIXELS = 20_000_000  # of all frames together: reading more delays the opening of a recording
_MIN_FRAMES = 3  # including the reference; the median of two is their mean
_BLOCKS_ALONG = 16  # along the longer side: large enough that noise and dithering average out
_SAME_GREY = 1.5  # grey levels: change of a block's mean without contact
_NOISE_FACTOR = 3.5  # times the median change, the limit where it is larger than `_SAME_GREY`
_MAX_NOISE_GREY = 4.0  # grey levels: median change beyond which frames are not alike
_QUIET_SHARE = 0.995  # of the blocks must be alike; dirt on the lens may cover the rest
_TOUCH_BLOCKS = 24  # along the longer side: markers and noise average out, a touch does not
_DIFFERS_GREY = 8.0  # grey levels: change of a block's mean by a touch, not noise
_MIN_RELIEF_GREY = 1.0  # grey levels: least relief of a touch
_MAX_RELIEF_RATIO = 0.6  # of a reference to the first frame, where they differ
# frames compared with the first: seeking in a long video is slow
_MAX_CANDIDATES = 16
_N_BRIGHTNESS = 5
# of the brightness of most blocks to that of later frames
_BRIGHT_RATIO = 0.92
_DARK_RATIO = 0.6
_RISE = 0.03  # of this ratio from frame to frame, while a camera starts that is not dark
_BLACK_GREY = 4.0  # grey level of a block that says nothing of the brightness
# grey level of a saturated block; more of them than usual, beyond a touch's glare
_WHITE_GREY = 250.0
_WHITE_SHARE = 0.05


def compute_block_means(image: NDArray[np.generic], n_along: int) -> Floats:
    """Means (block rows, block cols, channels) with `n_along` blocks along the longer side.

    NaN counts as 0.

    `image` is (rows, cols) or (rows, cols, channels).
    """
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(n_along * n / max(rows, cols))) for n in (cols, rows))
    values = np.nan_to_num(np.asarray(image, np.float32))
    means = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return means[..., None] if means.ndim == 2 else means


def find_first_reference(
    read: Callable[[int], Image], n_frames: int, name: Callable[[int], str], *, is_film: bool
) -> tuple[Image | None, str]:
    """(reference, note) of a sequence that begins untouched; `name` names a frame.

    Its first frames, after those of a camera that starts dark, are alike, and no later frame has
    clearly less contact. Else there is none, but for a film: then it is the frame with least
    contact, with a warning, or the first one. `read` raises FileProblem for a frame that cannot be
    read or has another size.
    """
    start = find_bright_start(read, n_frames)
    frames = read_until_damaged(read, range(start, n_frames))
    first = next(frames, None)
    if first is None:
        return None, ""
    reference, n_averaged = denoise_reference(first, frames)
    later = sample_frames(read, n_frames, first=start + n_averaged + 1)
    better = select_reference_frame(reference, later)
    if better is not None and is_film:
        at, image = better
        after = read_until_damaged(read, range(at + 1, n_frames))
        reference, n_averaged = denoise_reference(image, after)
        which = f"the median of frames {at} to {at + n_averaged}" if n_averaged else f"frame {at}"
        return reference, StageWarning(
            f"the first frame shows contact, so {which} is taken as the reference; if it shows "
            "contact too, depth is wrong: give a reference image with --reference"
        )
    if better is not None or not (n_averaged or is_film):
        return None, ""
    if n_averaged:
        which = f"the median of {name(start)} to {name(start + n_averaged)}, all alike,"
    else:
        which = name(start) if start else "the first frame"
    dark = "the frame before is" if start == 1 else f"the {start} frames before are"
    why = f"; {dark} darker or overexposed, as of a camera that starts" if start else ""
    return reference, f"{which} is taken as the reference{why}"


def find_untouched_reference(read: Callable[[int], Image], n_frames: int) -> tuple[Image, int]:
    """(median of the frames that are like the one with least contact, their number), of some over
    the recording.

    Raises FileProblem where no frame can be read.
    """
    start = find_bright_start(read, n_frames)
    first, *later = [*sample_frames(read, n_frames, first=start)] or [(start, read(start))]
    chosen, image = select_reference_frame(first[1], later) or first
    blocks = compute_block_means(image, _BLOCKS_ALONG)
    alike = (
        other
        for index, other in (first, *later)
        if index != chosen and other.shape == image.shape and _are_alike(other, blocks)
    )
    reference, n_averaged = denoise_reference(image, alike)
    return reference, n_averaged + 1


def find_bright_start(read: Callable[[int], Image], n_frames: int) -> int:
    """The first frame that is as bright as most: a camera may start black or overexposed, or expose
    longer and longer.

    A touch changes the brightness of some blocks, a gain that of all.
    """
    samples = [
        compute_block_means(image, _BLOCKS_ALONG)
        for _, image in sample_frames(read, n_frames, _N_BRIGHTNESS)
    ]
    samples = sorted((s for s in samples if s.max() > _BLACK_GREY), key=lambda s: float(s.mean()))
    if not samples:
        return 0
    usual = samples[3 * len(samples) // 4]
    before = -np.inf
    for index, image in read_each(read, range(n_frames)):
        blocks = compute_block_means(image, _BLOCKS_ALONG)
        ratio = _compute_brightness_ratio(blocks, usual) if blocks.shape == usual.shape else 0.0
        if (
            ratio >= _BRIGHT_RATIO
            and (blocks >= _WHITE_GREY).mean() > (usual >= _WHITE_GREY).mean() + _WHITE_SHARE
        ):
            continue
        if ratio >= _BRIGHT_RATIO:
            return index
        if index and before > _DARK_RATIO and ratio < before + _RISE:
            return 0  # a light that was changed later
        before = ratio
    return 0


def _compute_brightness_ratio(blocks: Floats, usual: Floats) -> float:
    return float(np.median(blocks[usual > _BLACK_GREY] / usual[usual > _BLACK_GREY]))


def sample_frames(
    read: Callable[[int], Image], n_frames: int, most: int = _MAX_CANDIDATES, *, first: int = 0
) -> Iterator[tuple[int, Image]]:
    """(index, frame) of `most` frames from `first` on, spread evenly.

    Those that cannot be read are skipped.
    """
    count = min(most, n_frames - first)
    return read_each(
        read,
        sorted({round(i) for i in np.linspace(first, n_frames - 1, count)}) if count > 0 else (),
    )


def read_each(read: Callable[[int], A], indices: Iterable[int]) -> Iterator[tuple[int, A]]:
    """(index, frame) of those that can be read."""
    for index in indices:
        with contextlib.suppress(FileProblem):
            yield index, read(index)


def read_until_damaged(read: Callable[[T], Image], frames: Iterable[T]) -> Iterator[Image]:
    """The images of frames, given by number or file, up to the first that cannot be read."""
    with contextlib.suppress(FileProblem):
        for frame in frames:
            yield read(frame)


def denoise_reference(reference: Image, frames: Iterable[Image]) -> tuple[Image, int]:
    """(median (rows, cols, 3) of the reference and the first frames without contact, number of
    these frames).

    `frames` is read up to the first frame with contact; with too few frames the result is
    (`reference`, 0).
    """
    n_max = min(_MAX_FRAMES, _MAX_PIXELS // max(1, reference.shape[0] * reference.shape[1]))
    reference_blocks = compute_block_means(reference, _BLOCKS_ALONG)
    stack = [reference]
    for image in frames:
        if (
            len(stack) > n_max
            or image.shape != reference.shape
            or not _are_alike(image, reference_blocks)
        ):
            break
        stack.append(image)
    if len(stack) < _MIN_FRAMES:
        return reference, 0
    return freeze(np.median(np.stack(stack), axis=0).round().astype(np.uint8)), len(stack) - 1


def _are_alike(image: Image, reference_blocks: Floats) -> bool:
    change = np.abs(compute_block_means(image, _BLOCKS_ALONG) - reference_blocks).max(axis=2)
    limit = max(_SAME_GREY, _NOISE_FACTOR * float(np.median(change)))
    return bool(
        np.quantile(change, _QUIET_SHARE) <= limit and float(np.median(change)) <= _MAX_NOISE_GREY
    )


def select_reference_frame(
    first: Image, later: Iterable[tuple[int, Image]]
) -> tuple[int, Image] | None:
    """(index, image) of the frame with least contact; None unless `first` clearly has more contact.

    A touch adds light and shade in one place, so that the image is less smooth there. Where two
    frames differ, the smoother one has less contact. Drift and exposure change the smoothness of
    both alike.
    """
    best: tuple[int, Image] | None = None
    first_blocks = best_blocks = compute_block_means(first, _TOUCH_BLOCKS)
    for index, image in later:
        if image.shape != first.shape:
            continue
        blocks = compute_block_means(image, _TOUCH_BLOCKS)
        is_smooth = _compute_relief_ratio(blocks, first_blocks) <= _MAX_RELIEF_RATIO
        if is_smooth and (best is None or _compute_relief_ratio(blocks, best_blocks) < 1.0):
            best = (index, image)
            best_blocks = blocks
    return best


def _compute_relief_ratio(other: Floats, one: Floats) -> float:
    """Relief of the blocks `other` over that of `one`, where the two differ.

    Infinite if they do not.
    """
    differs = np.abs(other - one).max(axis=2) > _DIFFERS_GREY
    if not differs.any():
        return np.inf
    here, there = (float(_compute_relief(blocks)[differs].mean()) for blocks in (other, one))
    return here / there if there > _MIN_RELIEF_GREY else np.inf


def _compute_relief(blocks: Floats) -> Floats:
    """Difference of each block (rows, cols) from the mean of its neighbours, in grey levels."""
    import cv2

    return np.abs(
        np.asarray(cv2.Laplacian(blocks, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE))
    ).max(axis=2)
