"""What differs between an untouched picture and a later one although nothing touches: the light, and where the lens is.

LEDs warm up and fade, daylight leaks in, a camera sits loose in its housing. Over blocks of pixels the later picture is

    I_c = (1 + g_c) R_c + b_c + r_c . (u, v) - s . grad R_c        per colour c; the shift s is the same for all

with R the reference. A touch fits none of this: its blocks are outliers, which a redescending weight leaves out of the
fit (Geman and McClure 1985), from a wide scale to a narrow one, so that no start has to be known. What a touch covers
says nothing of the drift; too few blocks that agree mean that it is not known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image, freeze
from pipeline.base.memo import Memo
from pipeline.base.stage_warnings import StageWarning
from pipeline.engine.digests import compute_cached_digest

_BLOCKS_ALONG = 54  # the longer side of a picture: more say no more about what is smooth
_LEAST_BLOCK_PX = 8
_SCALES_GREY = (24.0, 12.0, 6.0, 3.0)  # of the weights, fit after fit, before that of the noise
_AGREES_GREY = 1.5  # a block that the drift explains, where there is no more noise
_NOISES = 3.0  # standard deviations of the noise of a block's mean, where there is
_FEWEST_AGREE = 0.3  # of the blocks; with fewer, what agrees may be part of a touch
_MORE_AGREE = 0.25  # of the blocks than without any drift: a touch's far light looks like a little drift too
_LIKELY = (0.05, 8.0, 10.0, 1.5)  # standard deviations of gain, offset (grey), ramp (grey to the border), shift (px)
_BLOCK_NOISE_GREY = 0.5
_MOST_GAIN, _MOST_GREY, _MOST_SHIFT_PX = 0.2, 30.0, 8.0  # more is no drift: another unit, or a lamp that is out
_MOST_TURNS = 4
_SETTLED_PX = 0.05
_MOVED_PX = 0.1  # shifts below are left as they are: interpolation would blur more than they do
_TELL_GAIN, _TELL_GREY, _TELL_PX = 0.012, 2.5, 0.4  # what is worth a note
_BEYOND_GREY = (
    18.0  # all drift together: two simulated units that a drift explains 23 to 49; gain 3 %, ramp 12, 2 px: 11
)
_FOREIGN_GREY = 7.0  # by which three quarters of a picture differ from a reference that is not its own


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """How an untouched picture is to be changed to be that of now."""

    gain: Doubles  # (3,) 1 = none
    offset_grey: Doubles  # (3,)
    ramp_grey: Doubles  # (3, 2) from the middle to the border at the longer side, right and down
    shift_px: tuple[float, float]  # right and down

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know of it; empty where it is not worth a word."""
        told: list[str] = []
        change = float(self.gain.mean()) - 1.0
        grey = float(np.abs(self.offset_grey).max() + np.abs(self.ramp_grey).max())
        if max(float(np.abs(self.gain - 1.0).max()) / _TELL_GAIN, grey / _TELL_GREY) > 1.0:
            told.append(f"the light has drifted since the reference ({100 * change:+.1f} %, up to {grey:.0f} grey "
                        "levels across the picture): taken out")  # fmt: skip
        if math.hypot(*self.shift_px) > _TELL_PX:
            told.append(
                f"the picture has moved by {math.hypot(*self.shift_px):.1f} px against the reference: taken out"
            )
        return tuple(told)

    def exceeds_instance_drift(self, bright_grey: float) -> bool:
        """Whether so much light differs between untouched pictures, of this mean, that they may be of two units.

        A touch's own far light comes to as much beside a DIGIT's balls.
        """
        grey = float(np.abs(self.gain - 1.0).max()) * bright_grey
        return grey + float(np.abs(self.offset_grey).max() + np.abs(self.ramp_grey).max()) > _BEYOND_GREY


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftedReference:
    """The untouched picture as it would be now, and what was done to it."""

    image: Floats  # (rows, cols, 3) grey levels
    image_8bit: Image  # the same in 8 bits
    drift: Drift | None  # None = it could not be told
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Blocks:
    """A picture's means over blocks, and how fast they change with a shift."""

    mean: Floats  # (n, 3)
    by_x: Floats  # (n, 3) grey levels per pixel
    by_y: Floats


def apply_estimated_drift(image: Image, reference: Image) -> DriftedReference:
    """The reference (rows, cols, 3) with the light and the place of `image`, as far as untouched parts tell them."""
    return _stilled.get_or_make(
        (compute_cached_digest(image), compute_cached_digest(reference)), lambda: _made(image, reference)
    )


_stilled: Memo[tuple[str, str], DriftedReference] = Memo(2)  # the short cut and the stage ask for the same


def _made(image: Image, reference: Image) -> DriftedReference:
    drift, foreign = fit_drift(image, reference)
    told = StageWarning("most of the picture differs from the reference: it may be of another unit, or of another day")
    notes: tuple[str, ...] = (told,) if foreign else ()
    if drift is None:
        return DriftedReference(
            image=freeze(reference.astype(np.float32)), image_8bit=reference, drift=None, notes=notes
        )
    picture = apply_drift(reference, drift)
    grey = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return DriftedReference(image=freeze(picture), image_8bit=freeze(grey), drift=drift, notes=notes + drift.notes)


def describe_no_contact(still: DriftedReference) -> str:
    """What is said of a picture in which nothing is left once the drift is taken out."""
    if still.drift is not None and still.drift.notes:
        return "nothing touches the sensor, or a level face larger than the view"
    return "nothing touches the sensor"


def fit_drift(image: Image, reference: Image) -> tuple[Drift | None, bool]:
    """The drift from `reference` to `image`, None where too little speaks for one; whether they are of two units."""
    block = max(_LEAST_BLOCK_PX, round(max(image.shape) / _BLOCKS_ALONG))
    if min(image.shape[:2]) < 4 * block:
        return None, False
    now, still = compute_block_means(image, block), _references.get_or_make(
        (compute_cached_digest(reference), block), lambda: _blocks(reference.astype(np.float32), block)
    )  # fmt: skip
    agrees = max(_AGREES_GREY, _NOISES * _noise(now - still.mean.reshape(now.shape)))
    change = np.abs(now - still.mean.reshape(now.shape)).max(axis=2)
    alike = float((change < agrees).mean())
    foreign = float(np.percentile(change, 25)) > _FOREIGN_GREY
    if alike > 1.0 - _MORE_AGREE:
        return None, foreign
    place, shift, solution, agree = _place(*now.shape[:2]), np.zeros(2), np.zeros(14), 0.0
    for _ in range(_MOST_TURNS):
        solution, agree = _solved(now.reshape(-1, 3), still, place, shift, agrees)
        shift = shift + solution[12:]
        if float(np.abs(solution[12:]).max()) < _SETTLED_PX or math.hypot(*shift) > _MOST_SHIFT_PX:
            break
        still = _blocks(_moved(reference, shift), block)
    own = solution[:12].reshape(3, 4)
    small = float(np.abs(own[:, 0]).max()) < _MOST_GAIN and float(np.abs(own[:, 1:]).max()) < _MOST_GREY
    if not small or math.hypot(*shift) > _MOST_SHIFT_PX or agree < max(_FEWEST_AGREE, alike + _MORE_AGREE):
        return None, foreign
    return Drift(gain=1.0 + own[:, 0], offset_grey=own[:, 1], ramp_grey=own[:, 2:],
                 shift_px=(float(shift[0]), float(shift[1]))), False  # fmt: skip


def _noise(change: Floats) -> float:
    """Standard deviation of a block's mean, and a third more, from how neighbours differ where they differ least.

    Most of a picture changes smoothly; where it has markers and these have moved, a quarter of it does.
    """
    steps = np.abs(np.diff(change, axis=1)).max(axis=2)
    return 1.05 * float(np.quantile(steps, 0.25))


def apply_drift(reference: Image, drift: Drift) -> Floats:
    """The reference (rows, cols, 3) after the drift, in grey levels that may lie outside 0 to 255."""
    rows, cols = reference.shape[:2]
    small = math.hypot(*drift.shift_px) < _MOVED_PX
    moved = reference.astype(np.float32) if small else _moved(reference, np.array(drift.shift_px))
    along_x, along_y = (_axis(n, max(rows, cols)).astype(np.float32) for n in (cols, rows))
    gain, offset, ramp = (a.astype(np.float32) for a in (drift.gain, drift.offset_grey, drift.ramp_grey))
    moved *= gain
    moved += (offset + along_x[:, None] * ramp[:, 0])[None]
    moved += (along_y[:, None] * ramp[:, 1])[:, None]
    return moved


def compute_block_means(picture: Image | Floats, block: int) -> Floats:
    """Mean of every whole block (rows // block, cols // block, 3); the last few pixels are dropped."""
    import cv2

    rows, cols = (n // block for n in picture.shape[:2])
    whole = picture[: rows * block, : cols * block]
    # Sums of the rows of a block first: whole numbers, and half the time.
    kind = np.uint16 if picture.dtype == np.uint8 and block <= 256 else np.float32
    tall = np.add.reduce(whole.reshape(rows, block, -1), axis=1, dtype=kind).astype(np.float32)
    wide = cv2.resize(tall.reshape(rows, -1, 3), (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(wide, np.float32) / np.float32(block)


_references: Memo[tuple[str, int], _Blocks] = Memo(4)


def _blocks(picture: Floats, block: int) -> _Blocks:
    import cv2

    by_x, by_y = (0.5 * cv2.Sobel(picture, cv2.CV_32F, *axis, ksize=1) for axis in ((1, 0), (0, 1)))
    mean, by_x, by_y = (
        compute_block_means(np.asarray(a, np.float32), block).reshape(-1, 3) for a in (picture, by_x, by_y)
    )
    return _Blocks(mean=freeze(mean), by_x=freeze(by_x), by_y=freeze(by_y))


def _moved(reference: Image, shift_px: Doubles) -> Floats:
    import cv2

    by = np.array([[1.0, 0.0, shift_px[0]], [0.0, 1.0, shift_px[1]]])
    size = (reference.shape[1], reference.shape[0])
    moved = cv2.warpAffine(
        reference.astype(np.float32), by, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, np.float32)


def _axis(n: int, longer: int) -> Doubles:
    """Pixel places from -1 to 1 along the longer side."""
    return np.asarray((np.arange(n) - (n - 1) / 2) * (2.0 / longer), np.float64)


def _place(rows: int, cols: int) -> Floats:
    """(rows x cols, 2) right and down."""
    y, x = np.meshgrid(_axis(rows, max(rows, cols)), _axis(cols, max(rows, cols)), indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)


def _solved(now: Floats, still: _Blocks, place: Floats, shift: Doubles, agrees: float) -> tuple[Doubles, float]:
    """(gain - 1, offset, ramp of each colour, further shift), and the share of blocks that agree."""
    target = (now - still.mean).astype(np.float64)  # (n, 3)
    ones = np.ones(len(now))
    columns = np.stack(
        [np.stack([still.mean[:, c], ones, *place.T, -still.by_x[:, c], -still.by_y[:, c]]) for c in range(3)]
    )
    numbers = [np.r_[4 * c : 4 * c + 4, 12, 13] for c in range(3)]  # of which a colour depends
    own_prior = np.array([_LIKELY[0], _LIKELY[1], _LIKELY[2], _LIKELY[2]]) / _BLOCK_NOISE_GREY
    prior = np.concatenate([np.tile(own_prior, 3), np.full(2, _LIKELY[3] / _BLOCK_NOISE_GREY)]) ** -2.0
    weight = ones
    solution: Doubles = np.zeros(14)
    off = np.abs(target).max(axis=1)
    for scale in (*_SCALES_GREY, agrees, agrees):
        normal, right = np.diag(prior), np.zeros(14)
        right[12:] = -prior[12:] * shift
        weighted = columns * weight
        blocks, to = weighted @ columns.swapaxes(1, 2), weighted @ target.T[:, :, None]
        for c, where in enumerate(numbers):
            normal[np.ix_(where, where)] += blocks[c]
            right[where] += to[c, :, 0]
        solution = np.asarray(np.linalg.solve(normal, right), np.float64)
        off = np.abs(target.T - (solution[numbers][:, None] @ columns)[:, 0]).max(axis=0)
        weight = 1.0 / (1.0 + (off / scale) ** 2) ** 2
    return solution, float((off < agrees).mean())
