"""The load on a membrane, and its displacement without noise, from a noisy displacement image.

A membrane under tension T moves by u with -T lap u = lambda - dp: lambda >= 0 is the contact's
pressure, dp the rise of the air's, one number. Both are fitted to the image (after Kuppuswamy et
al. 2019, who invert a bubble's finite elements as a sparse convex program):

    minimise  1/2 |image - u|^2 + a sum r,   lap u = -r + rise,   r >= 0,

where r is lambda over the inner pressure, so neither T nor the pressure need be known: their ratio
is the curvature of the untouched membrane. The penalty keeps noise from becoming contact. Loads are
allowed around `candidates` only; elsewhere the membrane carries a uniform load, which removes most
of the noise. Outside the image any load may act.

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
# the weight a in mm^2, for depth cameras whose mean over one square mm has a standard deviation of
# 0.39 mm (soft_bubble)
_L1_WEIGHT = 0.039
# fourth root of ADMM's penalty: membrane waves of this length converge first
_PENALTY_MM = 2.9
_PENALTY_RANGE_PX = (2.1, 18.0)
_ITERATIONS = 60  # twice as many reduce the error by 0.6 %; half add 1.2 %
# from this iteration on, the load found is fitted without penalties, which bias it toward zero
_DEBIAS_AT = 46
_OVER_RELAXATION = np.float32(1.6)  # 1.5 to 1.8 in Boyd et al. 2011, 3.4.3; from 2 on it diverges
_PRESSURE_RISE_MAX = np.float32(0.25)  # of the inner pressure, under a contact
_LOAD_MIN = 1.5  # times the inner pressure


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
    multiplies the noise of usual depth cameras.
    """
    kappa = np.float32(curvature_per_mm * pixel_mm**2)
    problem = _Problem.from_image(moved_mm, seen, candidates, max(1, round(_BORDER_MM / pixel_mm)))
    step_px = min(
        max(_PENALTY_MM * noise_factor**0.25 / pixel_mm, _PENALTY_RANGE_PX[0]), _PENALTY_RANGE_PX[1]
    )
    u, load = _run_admm(
        problem, problem.pad_to_frame(start_mm), kappa, np.float32(step_px**4), noise_factor
    )
    inner = problem.inner
    return MembraneLoad(displacement_mm=freeze(u[inner].copy()), load=freeze(load[inner] / kappa))


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
    noise_factor: float,
) -> tuple[Floats, Floats]:
    """(displacement, load) on the frame after all iterations, starting from `u`."""
    inner = problem.inner
    sought = problem.sought
    free = problem.free
    lowest = -_PRESSURE_RISE_MAX * kappa
    threshold = np.float32(_L1_WEIGHT * noise_factor / (kappa * penalty))
    damping = _compute_damping(u.shape, float(penalty))
    outer = problem.beyond * np.float32(penalty / (penalty + 1))
    n_free = max(float(free.sum(dtype=np.float64)), 1.0)
    kept = np.ones(u.shape, np.float32)
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
            sought * (lowest + np.maximum(v - (threshold + lowest), 0) * kept)
            + outer * v
            + uniform * free
        )
        y = v - z
        if k == _DEBIAS_AT:
            load = sought * np.maximum(z - lowest, 0)
            kept[inner] = _mask_load(load[inner] / kappa)
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


def _mask_load(load: Floats) -> Floats:
    """1 on the load and its neighbours, 0 elsewhere."""
    import cv2

    strong = np.asarray(cv2.GaussianBlur(load, (0, 0), 0.7)) > _LOAD_MIN
    return np.asarray(cv2.dilate(strong.astype(np.uint8), np.ones((3, 3), np.uint8)), np.float32)


@derive_once
def _compute_squared_eigenvalues(shape: tuple[int, int]) -> Floats:
    """Squares of the five-point Laplacian's eigenvalues (rows, cols) in cosines."""
    ky, kx = (np.arange(n) * (math.pi / n) for n in shape)
    return freeze(((2 * np.cos(ky) - 2)[:, None] + (2 * np.cos(kx) - 2)[None, :]) ** 2)


def _compute_damping(shape: tuple[int, ...], penalty: float) -> Floats:
    rows, cols = shape
    return (1.0 / (1.0 + penalty * _compute_squared_eigenvalues((rows, cols)))).astype(np.float32)
