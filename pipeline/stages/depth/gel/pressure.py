"""The pressure on a bonded elastic layer that explains a measured surface.

    minimise  1/2 |A p - z|^2 + r/2 p' (D A) p + k sum p,   p >= 0,   |f|^2 = sum |grad f|^2 + |f - mean f|^2 / l^2

z is the surface, A the response of the layer (`physics.gel_layer`), D the gradient. A surface is integrated from
slopes, and the error of slopes is alike everywhere: the first part of the norm. The second holds long waves, to which
slopes are blind, such as the inside of a wide face; the level of the surface is free. The ridge r keeps waves that the
layer hardly shows from growing; the price k of load keeps what slopes are wrong by from becoming contact, and is
proportional to the load, since the errors of a light estimate are. Pressure is a sum of blobs (Gaussians) of positive
weight: noise has finer grains.

All operators are diagonal in cosines, which continue the image by its mirror image beyond the border: a contact that
leaves the view continues there. Pressure is in mm/mm, times 2 (1 - v^2) / E: neither stiffness nor unit matters.
Solved by accelerated projected gradients with restarts (Beck and Teboulle 2009), from coarse cells to fine ones.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import memoise
from pipeline.physics import gel_layer
from pipeline.sensors.parts import Gel
from pipeline.stages.depth.gel.contact_settings import ContactSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class CellSurface:
    """A surface on square cells."""

    surface_mm: Floats  # (rows, cols)
    inside: Mask  # (rows, cols) where slopes are measured; elsewhere the gel looks level
    cell_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Waves:
    """Operators of a grid in cosines."""

    down: Floats  # (rows, rows) cosine transform along columns
    across: Floats  # (cols, cols) transposed, along rows
    to_gradient: Floats  # (rows, cols) from the wave of the slopes' divergence to the gradient of the misfit
    curvature: Floats  # second derivative of the misfit and the ridge
    blob: Floats  # pressure of a blob
    displacement: Floats  # mm of a blob

    def transform(self, field: Floats) -> Floats:
        return np.asarray(self.down @ (field @ self.across), np.float32)

    def invert(self, wave: Floats) -> Floats:
        return np.asarray(self.down.T @ (wave @ self.across.T), np.float32)


def estimate_pressure(on: CellSurface, gel: Gel, settings: ContactSettings, start: Floats | None) -> Floats:
    """Weights (rows, cols) of the blobs that explain the surface; `start`: those of a similar one on the same cells."""
    price = settings.price_min
    if start is None:
        coarse = _downsample(on)
        start = np.zeros(coarse.surface_mm.shape, np.float32)
        for steps in settings.steps_coarse:
            start = _solve(coarse, gel, settings, start, price, steps)
            price = max(settings.price_min, settings.price_share * weigh_by_itself(start))
        start = _resize(start, on.surface_mm.shape)
        steps = settings.steps
    else:
        price = max(price, settings.price_share * weigh_by_itself(start))
        steps = settings.steps_warm
    return _solve(on, gel, settings, start, price, steps)


def compute_pressure(blobs: Floats, cell_mm: float, gel: Gel, settings: ContactSettings) -> Floats:
    """Pressure (rows, cols) in mm/mm of blobs with these weights, drawn narrower than they are: with sharper edges."""
    waves = _make_waves(gel, cell_mm, blobs.shape, replace(settings, blob_mm=settings.edge_blob_mm))
    return np.asarray(np.maximum(waves.invert(waves.blob * waves.transform(blobs)), 0.0), np.float32)


def compute_displacement(blobs: Floats, cell_mm: float, gel: Gel, settings: ContactSettings) -> Floats:
    """Displacement (rows, cols) in mm of a layer that goes on beyond the image, under blobs with these weights.

    Load at the border goes on for a part of the margin: it ends somewhere there.
    """
    continued, margin = (
        round(n * gel.thickness_mm / cell_mm) for n in (settings.continued_share, settings.margin_share)
    )
    padded = np.pad(np.pad(blobs, continued, mode="edge"), margin - continued)
    waves = _make_waves(gel, cell_mm, padded.shape, settings)
    moved = waves.invert(waves.displacement * waves.transform(padded))
    return np.ascontiguousarray(moved[margin : margin + blobs.shape[0], margin : margin + blobs.shape[1]])


def weigh_by_itself(pressure: Floats) -> float:
    """The mean pressure, weighted by pressure: that of the contact, however large the image is."""
    return float(np.square(pressure).sum(dtype=np.float64) / max(float(pressure.sum(dtype=np.float64)), 1e-9))


def refit_pressure(
    on: CellSurface, gel: Gel, settings: ContactSettings, blobs: Floats, touched: Mask
) -> tuple[Floats, CellSurface]:
    """Weights of the blobs where `touched` (rows, cols) alone, at no price, and the coarse cells of them.

    The price finds the contact, but makes its pressure too small.
    """
    coarse = _downsample(on)
    shape = coarse.surface_mm.shape
    allowed = _resize(touched.astype(np.float32), shape) > 0
    start = np.where(allowed, _resize(blobs, shape), np.float32(0.0))
    return _solve(coarse, gel, settings, start, 0.0, settings.steps_refit, allowed), coarse


def _solve(
    on: CellSurface, gel: Gel, settings: ContactSettings, start: Floats, price: float, steps: int,
    allowed: Mask | None = None,
) -> Floats:  # fmt: skip
    """Weights of the blobs after `steps` of descent."""
    from pipeline.stages.depth.gel.contact_kernels import descend

    waves = _make_waves(gel, on.cell_mm, on.surface_mm.shape, settings)
    data = waves.to_gradient * waves.transform(_compute_divergence(on))
    step, momentum = np.float32(1.0 / float(waves.curvature.max())), 1.0
    blobs, ahead = start.copy(), start.copy()
    if allowed is None:
        allowed = np.ones(start.shape, np.bool_)
    for _ in range(steps):
        gradient = waves.invert(np.asarray(waves.curvature * waves.transform(ahead) - data, np.float32))
        momentum = descend(blobs, ahead, gradient, allowed, step, np.float32(price), momentum)
    return blobs


def _compute_divergence(on: CellSurface) -> Floats:
    """The negated divergence (rows, cols) of the measured slopes, per mm."""
    from pipeline.stages.depth.gel.contact_kernels import compute_divergence

    out = np.empty_like(on.surface_mm)
    compute_divergence(on.surface_mm, on.inside, np.float32(on.cell_mm**-2), out)
    return out


@memoise(8)
def _make_waves(gel: Gel, cell_mm: float, shape: tuple[int, int], settings: ContactSettings) -> _Waves:
    ky, kx = (np.arange(n) * (math.pi / n) for n in shape)
    q = np.hypot(ky[:, None], kx[None, :]) / cell_mm
    layer = gel_layer.compute_compliance(gel, q)
    slope = np.sqrt(4.0 * np.sin(0.5 * ky)[:, None] ** 2 + 4.0 * np.sin(0.5 * kx)[None, :] ** 2) / cell_mm
    blob = np.exp(-0.5 * np.square(settings.blob_mm * q))
    moved = layer * blob
    norm = slope**2 + settings.level_mm**-2
    norm[0, 0], slope_sq = 0.0, np.maximum(slope**2, 1e-12)  # the level of the surface is not known
    down, across = (freeze(_make_cosines(n)) for n in shape)
    return _Waves(
        down=down, across=freeze(np.ascontiguousarray(across.T)),
        to_gradient=freeze((moved * norm / slope_sq).astype(np.float32)),
        curvature=freeze((moved**2 * norm + settings.ridge * moved * slope).astype(np.float32)),
        blob=freeze(blob.astype(np.float32)), displacement=freeze(moved.astype(np.float32)),
    )  # fmt: skip


def _make_cosines(n: int) -> Floats:
    """The orthonormal cosine transform (n, n) of n samples: for cells, products are faster than fast transforms."""
    waves, at = np.arange(n)[:, None], (np.arange(n) + 0.5)[None, :]
    table = np.sqrt(2.0 / n) * np.cos(np.pi / n * waves * at)
    table[0] /= math.sqrt(2.0)
    return table.astype(np.float32)


def _downsample(on: CellSurface) -> CellSurface:
    """The surface on cells of twice the width."""
    import cv2

    rows, cols = on.surface_mm.shape
    size = (-(-cols // 2), -(-rows // 2))
    small = np.asarray(cv2.resize(on.surface_mm, size, interpolation=cv2.INTER_AREA), np.float32)
    share = np.asarray(cv2.resize(on.inside.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    return CellSurface(surface_mm=small, inside=share > 0.99, cell_mm=on.cell_mm * cols / size[0])


def _resize(field: Floats, shape: tuple[int, ...]) -> Floats:
    import cv2

    return np.asarray(cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)
