"""The load on a membrane, and its displacement without noise, from a noisy displacement image.

A membrane under tension T moves by u with -T lap u = lambda - dp: lambda >= 0 is the contact's
pressure, dp the rise of the air's, one number. Both are fitted to the image (after Kuppuswamy et
al. 2019, who invert a bubble's finite elements as a sparse convex program):

    minimise  1/2 |image - u|^2 + a sum r + b/2 sum r^2 / spread^3,   lap u = -r + rise,   r >= 0,

where r is lambda over the inner pressure, so neither T nor the pressure need be known: their ratio
is the curvature of the untouched membrane. The first penalty keeps noise from becoming contact; the
second makes a contact coherent: `spread` is the current load averaged along its best direction or
around the pixel, so an isolated load costs more than one in a line or on a face. Loads are allowed
around `candidates` only; elsewhere the membrane carries a uniform load, which removes most of the
noise. Outside the image any load may act.

Solved by the alternating direction method of multipliers (ADMM; Boyd et al. 2011, over-relaxed);
the Laplacian is diagonal in cosines, so an iteration is one transform and its inverse. Pixels
without a value take the estimate.

Constants without a source have no better neighbour in a sweep (docs/experiments.md,
`depth_numbers`): a third less or half as much again changes the error by 2 % at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.derived import derive_once

_BORDER_MM = 5.0  # around the image, where unknown loads may act
# mm, standard deviation of a mean over 1 mm^2, for which the weights below hold: about what
_NOISE = 0.45
# `estimate_noise_mm2` measures on soft_bubble (0.39); soft_bubble_stereo has 0.74
# the weights a and b in mm^2 at that noise
_L1_WEIGHT = 0.045
_L2_WEIGHT = 1.0
# fourth root of ADMM's penalty at that noise: membrane waves of this length converge first
_PENALTY_MM = 3.0
_PENALTY_RANGE_PX = (2.1, 18.0)
_ITERATIONS = 60  # twice as many reduce the error by 0.6 %; half add 1.2 %
_REWEIGHT_AT = (12, 24, 36)  # iterations that update `spread`
# from this iteration on, the load found is fitted without penalties, which bias it toward zero
_DEBIAS_AT = 46
_OVER_RELAXATION = np.float32(1.6)  # 1.5 to 1.8 in Boyd et al. 2011, 3.4.3; from 2 on it diverges
_PRESSURE_RISE_MAX = np.float32(0.25)  # of the inner pressure, under a contact
# standard deviations of the averages
_LINE_MM = 1.3
_LINE_WIDTH_MM = 0.28
_FACE_MM = 1.2
_DIRECTIONS = 8
_FACE_GAIN = 2.0  # a load on a face is thinner than one on an edge, and no less likely
_SPREAD_MIN = np.float32(0.3)
_LOAD_MIN = 1.5  # times the inner pressure
_BLOCK_PX = 8
_BLOCKS_MIN = 8  # with 8 blocks the standard error of the median is two fifths
_BLOCK_SHARE_MIN = 0.7  # share of a block's pixels that must be free of contact


@dataclass(frozen=True, slots=True, kw_only=True)
class MembraneLoad:
    """A membrane's displacement and the load that causes it."""

    displacement_mm: Floats  # (rows, cols)
    load: Floats  # (rows, cols) contact pressure over inner pressure, >= 0


def estimate_load(
    moved_mm: Floats,
    seen: Mask,
    candidates: Mask,
    start_mm: Floats,
    *,
    pixel_mm: float,
    curvature_per_mm: float,
    noise_factor: float = 1.0,
) -> MembraneLoad:
    """The load (rows, cols) behind a noisy displacement, and the displacement that it causes.

    `moved_mm` must be finite; it is used where `seen`. `start_mm` is a smooth initial guess.
    `curvature_per_mm` is -lap of the untouched membrane: pressure over tension. `noise_factor`
    multiplies the noise measured in the image.
    """
    kappa = np.float32(curvature_per_mm * pixel_mm**2)
    noise = noise_factor * estimate_noise_mm2(moved_mm, seen & ~candidates, pixel_mm) / _NOISE
    problem = _Problem.from_image(moved_mm, seen, candidates, max(1, round(_BORDER_MM / pixel_mm)))
    step_px = min(
        max(_PENALTY_MM * noise**0.25 / pixel_mm, _PENALTY_RANGE_PX[0]), _PENALTY_RANGE_PX[1]
    )
    u, load = _run_admm(
        problem, problem.pad_to_frame(start_mm), kappa, np.float32(step_px**4), noise, pixel_mm
    )
    inner = problem.inner
    return MembraneLoad(displacement_mm=freeze(u[inner].copy()), load=freeze(load[inner] / kappa))


def estimate_noise_mm2(moved_mm: Floats, free: Mask, pixel_mm: float) -> float:
    """Standard deviation of a mean over one square mm, from blocks of pixels, so that it holds for
    coarse noise, too.

    The membrane's shape is removed by the fourth difference of five blocks in a row, all in `free`;
    with too few such blocks the value is typical of depth cameras.
    """
    rows, cols = (n // _BLOCK_PX * _BLOCK_PX for n in moved_mm.shape)

    def compute_block_means(a: Floats) -> Floats:
        cut = a[:rows, :cols].reshape(rows // _BLOCK_PX, _BLOCK_PX, cols // _BLOCK_PX, _BLOCK_PX)
        return np.asarray(cut.mean(axis=(1, 3)), np.float32)

    share = compute_block_means(free.astype(np.float32))
    mean = compute_block_means(np.where(free, moved_mm, np.float32(0.0))) / np.maximum(
        share, np.float32(_BLOCK_SHARE_MIN)
    )
    parts: list[Floats] = []
    for m, s in ((mean, share), (mean.T, share.T)):
        if len(m) >= 5:
            difference = m[:-4] - 4 * m[1:-3] + 6 * m[2:-2] - 4 * m[3:-1] + m[4:]
            whole = np.minimum.reduce([s[i : len(s) - 4 + i] for i in range(5)]) >= _BLOCK_SHARE_MIN
            parts.append(np.abs(difference[whole]))
    differences = np.concatenate(parts) if parts else np.zeros(0, np.float32)
    if differences.size < _BLOCKS_MIN:
        return _NOISE
    # 1.4826: standard deviation over median absolute value; 70 = 1 + 16 + 36 + 16 + 1: variance of
    # the difference.
    return 1.4826 * float(np.median(differences)) / math.sqrt(70.0) * _BLOCK_PX * pixel_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class _Problem:
    """An image padded by a frame; masks are 0 and 1, since products are faster than selections."""

    image: Floats
    seen: Floats
    sought: Floats  # where a contact load is allowed
    free: Floats  # the rest of the image: one uniform load
    beyond: Floats  # the frame: any load
    inner: tuple[slice, slice]

    @classmethod
    def from_image(cls, image: Floats, seen: Mask, candidates: Mask, border: int) -> _Problem:
        from scipy import fft

        shape = tuple(int(fft.next_fast_len(n + 2 * border, real=True) or 0) for n in image.shape)
        inner = (slice(border, border + image.shape[0]), slice(border, border + image.shape[1]))
        ends = [(border, big - border - n) for big, n in zip(shape, image.shape, strict=True)]
        sought, free = (np.pad(mask.astype(np.float32), ends) for mask in (candidates, ~candidates))
        return cls(
            image=np.pad(image, ends),
            seen=np.pad(seen.astype(np.float32), ends),
            sought=sought,
            free=free,
            beyond=1 - sought - free,
            inner=inner,
        )

    def pad_to_frame(self, image: Floats) -> Floats:
        """An image of the inner size, extended to the frame by its edge values."""
        ends = [
            (s.start, big - s.stop) for s, big in zip(self.inner, self.image.shape, strict=True)
        ]
        return np.pad(image, ends, mode="edge").astype(np.float32)

    def fill_gaps(self, u: Floats) -> Floats:
        """The image, with the estimate where nothing was measured."""
        return np.asarray(u + self.seen * (self.image - u), np.float32)


def _run_admm(
    problem: _Problem,
    u: Floats,
    kappa: np.float32,
    penalty: np.float32,
    noise: float,
    pixel_mm: float,
) -> tuple[Floats, Floats]:
    """(displacement, load) on the frame after all iterations, starting from `u`."""
    inner = problem.inner
    sought = problem.sought
    free = problem.free
    lowest = -_PRESSURE_RISE_MAX * kappa
    threshold = np.float32(_L1_WEIGHT * noise / (kappa * penalty))
    damping = _compute_damping(u.shape, float(penalty))
    outer = problem.beyond * np.float32(penalty / (penalty + 1))
    n_free = max(float(free.sum(dtype=np.float64)), 1.0)
    shrink = np.ones(u.shape, np.float32)
    z = sought * np.maximum(-_compute_laplacian(u), lowest)
    y = np.zeros_like(z)
    load = np.zeros_like(z)
    for k in range(_ITERATIONS):
        u = _update_displacement(problem.fill_gaps(u), penalty * _compute_laplacian(z - y), damping)
        v = y + (1 - _OVER_RELAXATION) * z - _OVER_RELAXATION * _compute_laplacian(u)
        uniform = np.float32(
            min(max(float((v * free).sum(dtype=np.float64)) / n_free, -float(kappa)), 0.0)
        )
        z = (
            sought * (lowest + np.maximum(v - (threshold + lowest), 0) * shrink)
            + outer * v
            + uniform * free
        )
        y = v - z
        if k in _REWEIGHT_AT:
            spread = np.maximum(
                _compute_spread((sought * (z - lowest))[inner] / kappa, pixel_mm), _SPREAD_MIN
            )
            shrink[inner] = 1 / (
                1 + np.float32(_L2_WEIGHT * noise * noise) / (spread**3 * (penalty * kappa * kappa))
            )
        if k == _DEBIAS_AT:
            load = sought * np.maximum(z - lowest, 0)
            shrink[inner] = _mask_load(load[inner] / kappa)
            threshold = np.float32(0.0)
    return u, load


def _update_displacement(target: Floats, pull: Floats, damping: Floats) -> Floats:
    """The displacement between the image and the one that the load causes."""
    from scipy import fft

    wave = np.asarray(fft.dctn(target - pull, norm="ortho"), np.float32) * damping
    return np.asarray(fft.idctn(wave, norm="ortho", overwrite_x=True), np.float32)


def _compute_laplacian(a: Floats) -> Floats:
    """The five-point Laplacian, mirrored at the border."""
    import cv2

    return np.asarray(
        cv2.Laplacian(a, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REFLECT), np.float32
    )


def _compute_spread(load: Floats, pixel_mm: float) -> Floats:
    """The mean load along the best line through each pixel, or over the face around it."""
    around = math.ceil(3 * max(_LINE_MM, _FACE_MM) / pixel_mm)
    box = tuple(
        slice(max(0, int(i.min()) - around), int(i.max()) + around + 1)
        for i in np.nonzero(load > 0)
        if i.size
    )
    spread = np.zeros_like(load)
    if box:
        spread[box] = _compute_spread_within(np.ascontiguousarray(load[box]), pixel_mm)
    return spread


def _compute_spread_within(load: Floats, pixel_mm: float) -> Floats:
    import cv2

    best = _FACE_GAIN * np.asarray(cv2.GaussianBlur(load, (0, 0), _FACE_MM / pixel_mm), np.float32)
    for line in _make_line_kernels(_LINE_MM / pixel_mm, max(_LINE_WIDTH_MM / pixel_mm, 0.5)):
        best = np.maximum(best, cv2.filter2D(load, cv2.CV_32F, line, borderType=cv2.BORDER_REFLECT))
    return np.asarray(best, np.float32)


def _mask_load(load: Floats) -> Floats:
    """1 on the load and its neighbours, 0 elsewhere."""
    import cv2

    strong = np.asarray(cv2.GaussianBlur(load, (0, 0), 0.7)) > _LOAD_MIN
    return np.asarray(cv2.dilate(strong.astype(np.uint8), np.ones((3, 3), np.uint8)), np.float32)


@derive_once
def _make_line_kernels(length_px: float, width_px: float) -> tuple[Floats, ...]:
    """Elongated Gaussians of sum 1, one for each direction."""
    reach = max(1, round(2 * length_px))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
    lines: list[Floats] = []
    for angle in np.arange(_DIRECTIONS) * (math.pi / _DIRECTIONS):
        along = x * np.cos(angle) + y * np.sin(angle)
        across = y * np.cos(angle) - x * np.sin(angle)
        line = np.exp(-0.5 * (along / length_px) ** 2 - 0.5 * (across / width_px) ** 2)
        lines.append(freeze((line / line.sum()).astype(np.float32)))
    return tuple(lines)


@derive_once
def _compute_squared_eigenvalues(shape: tuple[int, int]) -> Floats:
    """Squares of the five-point Laplacian's eigenvalues (rows, cols) in cosines."""
    ky, kx = (np.arange(n) * (math.pi / n) for n in shape)
    return freeze(((2 * np.cos(ky) - 2)[:, None] + (2 * np.cos(kx) - 2)[None, :]) ** 2)


def _compute_damping(shape: tuple[int, ...], penalty: float) -> Floats:
    rows, cols = shape
    return (1.0 / (1.0 + penalty * _compute_squared_eigenvalues((rows, cols)))).astype(np.float32)
