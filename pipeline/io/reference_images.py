"""Images of a gel without contact: with less noise, or replaced by a later frame.

The noise of one reference image enters every comparison; the median of a dozen has a third of it.
"""

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import numpy as np

from pipeline.core.arrays import Floats, Image, Stored, freeze
from pipeline.core.errors import FileProblem, StageWarning
from pipeline.core.frame_lists import spread_indices

TAKEN = "is taken as the reference"  # in every note of `find_first_reference`

T = TypeVar("T")
A = TypeVar("A", bound=Stored)

_MAX_FRAMES = 15
_MAX_PIXELS = 20_000_000  # of all frames together: reading more delays the opening of a recording
_MIN_FRAMES = 3  # including the reference; the median of two is their mean
_BLOCKS_ALONG = 16  # along the longer side: large enough that noise and dithering average out
_SAME_GREY = 1.5  # grey levels: change of a block's mean without contact
_NOISE_FACTOR = 3.5  # times the median change, the limit where it is larger than `_SAME_GREY`
_MAX_NOISE_GREY = 4.0  # grey levels: median change beyond which frames are not alike
_QUIET_SHARE = 0.995  # of the blocks must be alike; dirt on the lens may cover the rest
# blocks along the longer side, by scale: the first show a weave, markers average out in the last
_RELIEF_BLOCKS = (96, 48, 24, 12)
# Of a touch. Noise and drift: up to 0.02, by JPEG up to 0.13, of a dithered film up to 0.42; a book
# cover 0.3, large balls of .1 mm and light cloth from 0.4, paper 7.
_MORE_RELIEF = 0.25
_COARSE_RATIO = 2.0  # at most, of the relief of the largest blocks to that of all smaller ones
_ALIKE_RELIEF = 0.5  # the most of frames without contact that are averaged, dithered ones too
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


def compute_block_means(image: Stored, n_along: int) -> Floats:
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
    better, is_certain = select_reference_frame(first, later)
    if better is not None and is_film:
        at, image = better
        after = read_until_damaged(read, range(at + 1, n_frames))
        reference, n_averaged = denoise_reference(image, after)
        which = f"the median of frames {at} to {at + n_averaged}" if n_averaged else f"frame {at}"
        return reference, StageWarning(
            f"the first frame shows contact, so {which} {TAKEN}; if it shows contact too, "
            "depth is wrong: give a reference image with --reference"
        )
    if better is not None or not (n_averaged or is_film):
        return None, ""
    if n_averaged:
        which = f"the median of {name(start)} to {name(start + n_averaged)}, all alike,"
    else:
        which = name(start) if start else "the first frame"
    dark = "the frame before is" if start == 1 else f"the {start} frames before are"
    why = f"; {dark} darker or overexposed, as of a camera that starts" if start else ""
    note = f"{which} {TAKEN}{why}"
    if is_certain:
        return reference, note
    return reference, StageWarning(
        f"{note}; later frames differ from it, but none clearly has more contact or less: if it "
        "shows a touch, depth is wrong; give a reference image with --reference, or say which "
        "frames show none with --reference-frames"
    )


def find_untouched_reference(read: Callable[[int], Image], n_frames: int) -> tuple[Image, int]:
    """(median of the frames that are like the one with least contact, their number), of some over
    the recording.

    Raises FileProblem where no frame can be read.
    """
    start = find_bright_start(read, n_frames)
    first, *later = [*sample_frames(read, n_frames, first=start)] or [(start, read(start))]
    chosen, image = select_reference_frame(first[1], later)[0] or first
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
        lit = usual > _BLACK_GREY
        same_size = blocks.shape == usual.shape
        ratio = float(np.median(blocks[lit] / usual[lit])) if same_size else 0.0
        if ratio >= _BRIGHT_RATIO:
            if (blocks >= _WHITE_GREY).mean() > (usual >= _WHITE_GREY).mean() + _WHITE_SHARE:
                continue
            return index
        if index and before > _DARK_RATIO and ratio < before + _RISE:
            return 0  # a light that was changed later
        before = ratio
    return 0


def sample_frames(
    read: Callable[[int], Image], n_frames: int, most: int = _MAX_CANDIDATES, *, first: int = 0
) -> Iterator[tuple[int, Image]]:
    """(index, frame) of `most` frames from `first` on, spread evenly.

    Those that cannot be read are skipped.
    """
    return read_each(read, spread_indices(n_frames, most, first))


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
    scales = _average_by_scale(reference)
    stack = [reference]
    for image in frames:
        if (
            len(stack) > n_max
            or image.shape != reference.shape
            or not _are_alike(image, reference_blocks)
            or abs(_compute_more_relief(scales, _average_by_scale(image))) > _ALIKE_RELIEF
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
) -> tuple[tuple[int, Image] | None, bool]:
    """((index, image) of the frame with least contact, whether it is certain); None unless `first`
    clearly has more contact.

    It is uncertain where frames differ from the first and none clearly has more contact or less.
    """
    best: tuple[int, Image] | None = None
    blocks = compute_block_means(first, _BLOCKS_ALONG)
    scales = least = _average_by_scale(first)
    differ = has_more = False
    for index, image in later:
        if image.shape != first.shape:
            continue
        found = _average_by_scale(image)
        has_more |= _compute_more_relief(scales, found) > _MORE_RELIEF
        differ |= not _are_alike(image, blocks)
        if _compute_more_relief(least, found) < (-_MORE_RELIEF if best is None else 0.0):
            best, least = (index, image), found
    return best, best is not None or has_more or not differ


def _average_by_scale(image: Image) -> list[Floats]:
    """Block means by scale, without a border as wide as the largest block: glints of the gel's edge
    come and go there.
    """
    border = -(-max(image.shape) // _RELIEF_BLOCKS[-1])
    inner = image[border:-border, border:-border]
    inner = inner if inner.size else image
    return [compute_block_means(inner, min(n, max(inner.shape) // 2)) for n in _RELIEF_BLOCKS]


def _compute_more_relief(one: list[Floats], other: list[Floats]) -> float:
    """How much more relief the second image has than the first, both as block means by scale.

    A touch adds light and shade to what a gel shows anyway, so that the squared relief grows by the
    squared change, and shrinks by it where the touch ends. Of noise and of two touches neither is
    the case. The sum over scales of log(ratio of squared reliefs where the images differ) times
    |difference of squared reliefs / squared change|, the latter at most 1. What the largest blocks
    alone show may be light.
    """
    ratio = np.median(other[-1] / np.maximum(one[-1], 1.0), axis=(0, 1))
    gain = np.maximum(ratio, 0.01).astype(np.float32)
    more = list[float]()
    for before, after in zip(one, other, strict=True):
        here = _compute_relief(before)
        there = _compute_relief(after / gain)
        change = ((there - here) ** 2).sum(axis=2)
        squares = [(relief**2).sum(axis=2) for relief in (here, there)]
        grown = float(squares[1].sum() - squares[0].sum())
        low, high = (float((change * square).sum()) + 1e-6 for square in squares)
        share = min(1.0, abs(grown) / (float(change.sum()) + 1e-6))
        more.append(share * math.log(high / low))
    *fine, coarse = more
    limit = _COARSE_RATIO * abs(sum(fine))
    return sum(fine) + min(max(coarse, -limit), limit)


def _compute_relief(blocks: Floats) -> Floats:
    """Difference of each block (rows, cols, channels) from the mean of its neighbours."""
    import cv2

    relief = cv2.Laplacian(blocks, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(relief, np.float32)
