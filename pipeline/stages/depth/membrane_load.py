"""The load on a membrane, and its displacement without noise, from a noisy displacement image.

A membrane under tension T moves by u with -T lap u = lambda - dp: lambda >= 0 is the contact's
pressure, dp the rise of the air's, one number. Both are fitted to the image (after Kuppuswamy et
al. 2019, who invert a bubble's finite elements as a sparse convex program):

    minimise  1/2 |image - u|^2 + a sum r,   lap u = -r + rise,   r >= 0,

where r is lambda over the inner pressure, so neither T nor the pressure need be known: their ratio
is the curvature of the untouched membrane. The penalty keeps noise from becoming contact. Loads are
allowed around `candidates` only; elsewhere the membrane carries a uniform load, which removes most
of the noise. On the image border any load may act: what the membrane does beyond is not known.

Solved by the alternating direction method of multipliers (ADMM; Boyd et al. 2011, over-relaxed);
the Laplacian is diagonal in cosines, so an iteration is one transform and its inverse. Pixels
without a value take the estimate.

Constants without a source have no better neighbour in a sweep (docs/experiments.md,
`depth_numbers`): a third less or half as much again changes the error by 2 % at most.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.stages.depth.contact import downsample

_NOISE = 0.39  # standard deviation of a mean over one square mm, times mm^2: soft_bubble
_BLOCK_PX = 8
_BLOCK_SHARE_MIN = 0.7  # of a block's pixels, free of contact
_BLOCKS_MIN = 8  # with 8 blocks the standard error of the median is two fifths
_L1_WEIGHT = 0.039  # the weight a in mm^2 at that noise
# fourth root of ADMM's penalty at that noise: membrane waves of this length converge first
_PENALTY_MM = 2.9
_PENALTY_RANGE_PX = (2.1, 18.0)
_ITERATIONS = 60  # twice as many reduce the error by 0.6 %; half add 1.2 %
# from this iteration on, the load found is fitted without penalties, which bias it toward zero
_DEBIAS_AT = 46
_OVER_RELAXATION = np.float32(1.6)  # 1.5 to 1.8 in Boyd et al. 2011, 3.4.3; from 2 on it diverges
_PRESSURE_RISE_MAX = np.float32(0.25)  # of the inner pressure, under a contact
_LOAD_MIN = 1.5  # times the inner pressure


@frozen
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
    inner = np.pad(np.ones(np.subtract(start_mm.shape, 2), np.bool_), 1)
    read, sought, free = (
        mask.astype(np.float32) for mask in (seen, inner & candidates, inner & ~candidates)
    )
    known = start_mm + read * (moved_mm - start_mm)
    noise_factor *= _estimate_noise(np.asarray(known, np.float32), read * free, pixel_mm)
    step_px = min(
        max(_PENALTY_MM * noise_factor**0.25 / pixel_mm, _PENALTY_RANGE_PX[0]), _PENALTY_RANGE_PX[1]
    )
    penalty = np.float32(step_px**4)
    damping = _compute_damping(start_mm.shape, float(penalty))
    outer = np.where(inner, np.float32(0.0), penalty / (penalty + 1))
    n_free = max(float(free.sum(dtype=np.float64)), 1.0)
    lowest = -_PRESSURE_RISE_MAX * kappa
    threshold = np.float32(_L1_WEIGHT * noise_factor / (kappa * penalty))
    kept = np.ones_like(sought)
    u = start_mm
    z = sought * np.maximum(-_compute_laplacian(u), lowest)
    y = np.zeros_like(z)
    load = np.zeros_like(z)
    for k in range(_ITERATIONS):
        # the estimate where nothing was measured
        known = np.asarray(u + read * (moved_mm - u), np.float32)
        u = _update_displacement(known, penalty * _compute_laplacian(z - y), damping)
        v = y + (1 - _OVER_RELAXATION) * z - _OVER_RELAXATION * _compute_laplacian(u)
        uniform = np.float32(
            min(max(float((v * free).sum(dtype=np.float64)) / n_free, -float(kappa)), 0.0)
        )
        pressed = kept * np.maximum(v - (threshold + lowest), 0)
        z = sought * (lowest + pressed) + uniform * free + outer * v
        y = v - z
        if k == _DEBIAS_AT:
            load = sought * np.maximum(z - lowest, 0)
            kept = (load > _LOAD_MIN * kappa).astype(np.float32)
            threshold = np.float32(0.0)
    return MembraneLoad(displacement_mm=freeze(u), load=freeze(load / kappa))


def _estimate_noise(moved_mm: Floats, free: Floats, pixel_mm: float) -> float:
    """Noise of an image (rows, cols) over `_NOISE`, from blocks of pixels, so that it holds for
    coarse noise, too; as usual where few are `free` of contact.

    Fourth differences leave out the membrane's shape.
    """
    shares = np.lib.stride_tricks.sliding_window_view(downsample(free, _BLOCK_PX), 5, axis=1)
    whole = shares.min(axis=-1) > _BLOCK_SHARE_MIN
    differences = np.abs(np.diff(downsample(moved_mm, _BLOCK_PX), 4, axis=1)[whole])
    if len(differences) < _BLOCKS_MIN:
        return 1.0
    # 1.4826: standard deviation over median absolute value; 70 = 1 + 16 + 36 + 16 + 1: variance of
    # the difference
    blocks = 1.4826 * float(np.median(differences)) / math.sqrt(70.0)
    return blocks * _BLOCK_PX * pixel_mm / _NOISE


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


@derive_once
def _compute_damping(shape: tuple[int, ...], penalty: float) -> Floats:
    """What is left of each cosine wave (rows, cols) of the target."""
    ky, kx = (2 * np.cos(np.arange(n) * (math.pi / n)) - 2 for n in shape)
    return freeze((1.0 / (1.0 + penalty * (ky[:, None] + kx) ** 2)).astype(np.float32))
