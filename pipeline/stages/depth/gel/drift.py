"""Drift between a reference image and a later one: changes of the light and of the lens position
without a touch.

LEDs warm up and fade, daylight leaks in, a camera sits loosely in its housing. Over blocks of
pixels the later image is

    I_c = (1 + g_c) R_c + b_c + r_c . (u, v) - s . grad R_c        per colour c; the shift s is the
                                                                   same for all

with R the reference. A gain that all colours and most blocks share and that is more than a tenth is
the camera's exposure: one number, taken out of R before the fit. A touch fits none of this: its
blocks are outliers, which a redescending weight removes from the fit (Geman and McClure 1985), from
a wide scale to a narrow one, so no initial guess is needed. If too few blocks agree, the drift is
unknown. What a wide, smooth dent explains (`change`) is taken from the image first, so that drift
does not take it for its own; a small one is an outlier, and what the coarse light gets wrong of it
would be taken for drift.

A touch changes light far from it as well: by light that its flanks scatter, and by gel that bulges.
That looks like a small drift. So a small one is left alone, a large one removed, and one in between
in part: noise moves the result gradually.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.calibration.slope_model import compute_positions
from pipeline.core.arrays import Doubles, Floats, Image, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import StageWarning
from pipeline.core.frozen import frozen
from pipeline.stages.depth.gel.coarse_light import compute_block_means
from pipeline.stages.depth.gel.settings import CHANGE


@frozen
class Drift:
    """The change from a reference to a current image without a touch."""

    gain: Doubles  # (3,) 1 = none
    offset_grey: Doubles  # (3,)
    ramp_grey: Doubles  # (3, 2) from the centre to the border along the longer side, right and down
    shift_px: tuple[float, float]  # right and down

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user; empty for a small drift."""
        notes: list[str] = []
        change = float(self.gain.mean()) - 1.0
        grey = float(np.abs(self.offset_grey).max() + np.abs(self.ramp_grey).max())
        if (
            max(
                float(np.abs(self.gain - 1.0).max()) / CHANGE.drift_note_gain,
                grey / CHANGE.drift_note_grey,
            )
            > 1.0
        ):
            notes.append(
                f"the light has drifted since the reference ({100 * change:+.1f} %, up to "
                f"{grey:.0f} grey "
                "levels across the image); it is removed"
            )
        if math.hypot(*self.shift_px) > CHANGE.drift_note_px:
            notes.append(
                f"the image has moved by {math.hypot(*self.shift_px):.1f} px against the "
                "reference; it is removed"
            )
        return tuple(notes)

    def exceeds_instance_drift(self, bright_grey: float) -> bool:
        """Whether the light changed so much, for images of this mean, that they may be of two
        sensor instances.

        Stray light of a touch reaches as much with a DIGIT's balls.
        """
        grey = float(np.abs(self.gain - 1.0).max()) * bright_grey
        return (
            grey + float(np.abs(self.offset_grey).max() + np.abs(self.ramp_grey).max())
            > CHANGE.drift_instance_drift_grey
        )


@frozen
class RestImage:
    """A reference with the drift of a later image applied."""

    image: Floats  # (rows, cols, 3) grey levels
    image_8bit: Image  # the same in 8 bits
    drift: Drift | None  # None = unknown
    exposure: float  # gain of the camera since the reference, where it is larger than a drift
    notes: tuple[str, ...]


@frozen
class _Blocks:
    """Means of an image over blocks, and their derivatives by a shift."""

    mean: Floats  # (n, 3)
    by_x: Floats  # (n, 3) grey levels per pixel
    by_y: Floats


@dataclass(frozen=True, kw_only=True)  # without slots, which a cached property needs
class _ReferenceSums:
    """Sums of a reference image over all rectangles: block means for any shift without moving an
    image.
    """

    sums: Doubles  # (rows + 1, cols + 1, 3) of the image with its margin
    margin: int  # px
    block: int
    shape: tuple[int, int]  # of the blocks

    @cached_property
    def still(self) -> _Blocks:
        """The blocks without a shift."""
        return self.compute_blocks(np.zeros(2), 1.0)

    def compute_blocks(self, shift_px: Doubles, gain: float) -> _Blocks:
        """The blocks of the image moved by a shift (right, down) of at most the margin, times a
        gain.
        """
        from pipeline.stages.depth.gel.change_kernels import measure_moved_blocks

        margin = self.margin
        first = margin - np.clip(shift_px[::-1], -margin + 2.0, margin - 3.0)
        images = np.empty((3, *self.shape, 3), np.float32)
        scale = gain / self.block**2
        measure_moved_blocks(self.sums, first, self.block, scale, images[0], images[1], images[2])
        mean, by_x, by_y = (freeze(image.reshape(-1, 3)) for image in images)
        return _Blocks(mean=mean, by_x=by_x, by_y=by_y)


def estimate_rest_image(
    image: Image, reference: Image, dent_grey: Floats | None = None
) -> RestImage:
    """The reference (rows, cols, 3) in the light and place of `image`, as far as what no dent
    explains shows them.

    `dent_grey` as `fit_drift` takes it.
    """
    drift, foreign, exposure = fit_drift(image, reference, dent_grey)
    warning = StageWarning(
        "most of the image differs from the reference, so depth may be wrong: record a new "
        "reference of this sensor"
    )
    notes: tuple[str, ...] = (warning,) if foreign else ()
    if drift is None:
        return RestImage(
            image=freeze(reference.astype(np.float32)),
            image_8bit=reference,
            drift=None,
            exposure=exposure,
            notes=notes,
        )
    picture = apply_drift(reference, drift)
    grey = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return RestImage(
        image=freeze(picture),
        image_8bit=freeze(grey),
        drift=drift,
        exposure=exposure,
        notes=notes + drift.notes,
    )


def describe_no_contact(still: RestImage) -> str:
    """The note for a frame without change after the drift is removed."""
    if still.drift is not None and still.drift.notes:
        return "nothing touches the sensor, or a level face larger than the view"
    return "nothing touches the sensor"


def fit_drift(
    image: Image, reference: Image, dent_grey: Floats | None = None
) -> tuple[Drift | None, bool, float]:
    """(drift from `reference` to `image` to remove, None if unknown; whether they may be of two
    sensor instances; the gain of the camera, where it is larger than a drift, else 1).

    `dent_grey` (rows, cols, 3) of any blocks is the change by a dent, which is no drift.
    """
    import cv2

    block = max(CHANGE.drift_block_min_px, round(max(image.shape) / CHANGE.drift_blocks_along))
    if min(image.shape[:2]) < 4 * block:
        return None, False, 1.0
    sums = _sum_reference(reference, block)
    now = compute_block_means(image, block)
    still = sums.still
    exposure = _compare_exposure(now, still)
    if dent_grey is not None and dent_grey.any():
        now = now - np.float32(exposure) * cv2.resize(
            dent_grey, now.shape[1::-1], interpolation=cv2.INTER_LINEAR
        )
    change = np.abs(now - still.mean.reshape(now.shape)).max(axis=2)
    still = still if exposure == 1.0 else sums.compute_blocks(np.zeros(2), exposure)
    residual = now - still.mean.reshape(now.shape)
    agrees = _compute_agreement_grey(residual)
    foreign = float(np.percentile(np.abs(residual).max(axis=2), 25)) > CHANGE.drift_foreign_grey
    if (
        agrees <= CHANGE.drift_agreement_grey
        and float((change < agrees).mean()) > 1.0 - CHANGE.drift_agreement_gain[0]
    ):
        return None, foreign, exposure
    place = np.stack(np.meshgrid(*compute_positions(now.shape[:2])), -1).reshape(-1, 2)
    shift = np.zeros(2)
    solution = np.zeros(14)
    weight = np.ones(len(place), np.float32)
    scales = [*CHANGE.drift_scales_grey, agrees, agrees]
    for _ in range(CHANGE.drift_iterations):
        fit = _solve(now.reshape(-1, 3), still, place, shift, weight, scales)
        solution, left, weight = fit
        scales = [agrees]
        residual = left.reshape(now.shape)
        shift = shift + solution[12:]
        if (
            float(np.abs(solution[12:]).max()) < CHANGE.drift_shift_tolerance_px
            or math.hypot(*shift) > CHANGE.drift_shift_max_px
        ):
            break
        still = sums.compute_blocks(shift, exposure)
    agrees = _compute_agreement_grey(residual)  # texture that has moved looks like noise before
    alike, agree = (float((a < agrees).mean()) for a in (change, np.abs(residual).max(axis=2)))
    own = solution[:12].reshape(3, 4)
    small = (
        float(np.abs(own[:, 0]).max()) < CHANGE.drift_gain_max
        and float(np.abs(own[:, 1:]).max()) < CHANGE.drift_grey_max
    )
    share = _step(agree - alike, CHANGE.drift_agreement_gain)
    if (
        not small
        or math.hypot(*shift) > CHANGE.drift_shift_max_px
        or agree < CHANGE.drift_agreement_min
        or share == 0.0
    ):
        return None, foreign, exposure
    gain = 1.0 + share * (exposure * (1.0 + own[:, 0]) - 1.0)
    own = share * own
    shift = share * shift
    fitted = Drift(
        gain=gain,
        offset_grey=own[:, 1],
        ramp_grey=own[:, 2:],
        shift_px=(float(shift[0]), float(shift[1])),
    )
    return fitted, False, exposure


def remove_exposure(image: Image, exposure: float) -> Image:
    """The image (rows, cols, 3) as with the exposure of its reference."""
    return (
        image
        if exposure == 1.0
        else np.clip(np.rint(image * np.float32(1.0 / exposure)), 0, 255).astype(np.uint8)
    )


def _compare_exposure(means: Floats, reference: _Blocks) -> float:
    """The gain that all colours of most blocks (rows, cols, 3) share."""
    now = means.reshape(-1, 3)
    still = reference.mean
    low, high = CHANGE.drift_exposure_grey
    usable = (still > low) & (now < high)
    if not usable.any():
        return 1.0
    ratio = now[usable] / still[usable]
    gain = float(np.median(ratio))
    if (
        abs(gain - 1.0) < CHANGE.drift_exposure_min
        or not 1.0 / CHANGE.drift_exposure_max < gain < CHANGE.drift_exposure_max
    ):
        return 1.0
    return (
        gain
        if float((np.abs(ratio / gain - 1.0) < CHANGE.drift_exposure_tolerance).mean())
        >= CHANGE.drift_exposure_share
        else 1.0
    )


def _step(value: float, limits: tuple[float, float]) -> float:
    """0 below the limits, 1 above, smooth in between."""
    at = min(max((value - limits[0]) / (limits[1] - limits[0]), 0.0), 1.0)
    return at * at * (3.0 - 2.0 * at)


def _compute_agreement_grey(residual: Floats | Doubles) -> float:
    """The residual (grey) up to which a block (rows, cols, 3) agrees."""
    return max(
        CHANGE.drift_agreement_grey, CHANGE.drift_agreement_sigmas * _estimate_noise(residual)
    )


def _estimate_noise(change: Floats | Doubles) -> float:
    """1.05 times the quarter quantile of the differences of neighbouring blocks: 4/3 of a block's
    standard deviation.

    Most of an image changes smoothly; with moved markers, a quarter of it does.
    """
    steps = np.abs(np.diff(change, axis=1)).max(axis=2)
    return 1.05 * float(np.quantile(steps, 0.25))


def apply_drift(reference: Image, drift: Drift) -> Floats:
    """The reference (rows, cols, 3) with the drift applied; grey levels may lie outside 0 to 255.

    Where a longer exposure than the reference's has clipped the image, the reference is clipped as
    well.
    """
    rows, cols = reference.shape[:2]
    small = math.hypot(*drift.shift_px) < CHANGE.drift_shift_min_px
    moved = (
        reference.astype(np.float32) if small else _shift_image(reference, np.array(drift.shift_px))
    )
    along_x, along_y = compute_positions((rows, cols))
    gain, offset, ramp = (
        a.astype(np.float32) for a in (drift.gain, drift.offset_grey, drift.ramp_grey)
    )
    moved *= gain
    moved += (offset + along_x[:, None] * ramp[:, 0])[None]
    moved += (along_y[:, None] * ramp[:, 1])[:, None]
    return (
        np.minimum(moved, np.float32(255.0))
        if float(drift.gain.min()) > 1.0 + CHANGE.drift_exposure_min
        else moved
    )


@derive_once
def _sum_reference(reference: Image, block: int) -> _ReferenceSums:
    """The sums of a reference image (rows, cols, 3); its border is replicated."""
    import cv2

    margin = math.ceil(2 * CHANGE.drift_shift_max_px) + 2
    sums = cv2.integral(
        cv2.copyMakeBorder(reference, margin, margin, margin, margin, cv2.BORDER_REPLICATE),
        sdepth=cv2.CV_64F,
    )
    shape = (reference.shape[0] // block, reference.shape[1] // block)
    return _ReferenceSums(
        sums=freeze(np.asarray(sums, np.float64)), margin=margin, block=block, shape=shape
    )


def _shift_image(reference: Image, shift_px: Doubles) -> Floats:
    import cv2

    by = np.array([[1.0, 0.0, shift_px[0]], [0.0, 1.0, shift_px[1]]])
    size = (reference.shape[1], reference.shape[0])
    moved = cv2.warpAffine(
        reference.astype(np.float32),
        by,
        size,
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(moved, np.float32)


def _solve(
    now: Floats, still: _Blocks, place: Floats, shift: Doubles, weight: Floats, scales: list[float]
) -> tuple[Doubles, Floats, Floats]:
    """(gain - 1, offset, ramp of each colour, then a further shift: (14,).

    What is left of each block (n, 3); the weights (n,) by that). One fit for each of the scales.
    """
    target = (now - still.mean).T  # (3, n)
    ones = np.ones(len(now), np.float32)
    columns = np.stack(
        [
            np.stack([still.mean[:, c], ones, *place.T, -still.by_x[:, c], -still.by_y[:, c]])
            for c in range(3)
        ]
    )
    numbers = [np.r_[4 * c : 4 * c + 4, 12, 13] for c in range(3)]  # unknowns of each colour
    gain, offset, ramp, moved = CHANGE.drift_prior_std
    stds = np.array([*(gain, offset, ramp, ramp) * 3, moved, moved])
    prior = (CHANGE.drift_block_noise_grey / stds) ** 2
    solution: Doubles = np.zeros(14)
    left = target
    for scale in scales:
        normal = np.diag(prior)
        right = np.zeros(14)
        right[12:] = -prior[12:] * shift
        weighted = columns * weight
        blocks = weighted @ columns.swapaxes(1, 2)
        to = weighted @ target[:, :, None]
        for c, where in enumerate(numbers):
            normal[np.ix_(where, where)] += blocks[c]
            right[where] += to[c, :, 0]
        solution = np.asarray(np.linalg.solve(normal, right), np.float64)
        fitted = solution[numbers].astype(np.float32)
        left = target - (fitted[:, None] @ columns)[:, 0]
        weight = 1.0 / (1.0 + (np.abs(left).max(axis=0) * np.float32(1.0 / scale)) ** 2) ** 2
    return solution, left.T, weight
