"""Light of LEDs close to the gel as a smooth shading field, and its fit to one touch.

Close LEDs change the colours differently from instance to instance, and many times over within one
image: next to a LED a slope hardly changes its colour. Each colour k of the relative change q
(`slope_model`) is linear in the normal n and the indentation z, q_k(p) = a_k(p) . (n - e_z) +
b_k(p) z, with smooth fields a, b (`calibration.shading_field`).

A touch that is at rest all around determines how the changes of its colours relate to each other,
for its slopes have to be those of one surface; but a deeper surface in weaker light looks the same.
How deep it is then follows from how likely such light is (`near_led_prior`). Of surfaces of one
shape, that of the depth with the likeliest colours is taken (the vertex of a parabola through three
depths): it moves with the colours, without a jump,

    -2 ln p(q) = sum w q^2 + m' P m - b' P'^-1 b + ln det P',     P' = P + sum w f f',   b = P m +
                                                                  sum w f q

with m and P the mean and precision of the prior, f what a pixel's light depends on and w its
weight.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import near_led_prior, slope_model
from pipeline.calibration.shading_field import (
    N_POSITION_TERMS,
    N_SHADING_TERMS,
    POSITION_DEGREE,
    ShadingFieldPrior,
)
from pipeline.core.arrays import Doubles, Floats, Mask
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.physics import optics
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.coarse_light import compute_block_px
from pipeline.stages.depth.gel.settings import LIGHT, SURFACE
from pipeline.stages.depth.illumination.light import (
    Illumination,
    ImagePatch,
    Light,
    RenderedChange,
    TouchObservation,
)
from pipeline.stages.depth.illumination.surface_refinement import clip_surface, refine_surface


@frozen
class FieldLight(Light):
    """A shading field over one patch."""

    field: Floats  # (rows, cols, 3, N_SHADING_TERMS) grey levels per unit

    def render(self, surface_mm: Floats, gx: Floats, gy: Floats) -> RenderedChange:
        """Render the light of a surface (rows, cols) with these slopes."""
        from pipeline.stages.depth.illumination.illumination_kernels import render_field_light

        out = RenderedChange(*(np.empty_like(self.patch.change) for _ in range(3)))
        render_field_light(gx, gy, surface_mm, self.field, *out)
        return out


def make_field_light(coefficients: Doubles, patch: ImagePatch, source: SensorSpec) -> FieldLight:
    """The shading field of `coefficients` (m,) over a patch."""
    places = slope_model.locate(patch.x_px, patch.y_px, source.camera.shape)
    field = expand_field(coefficients, *places)
    field /= slope_model.compute_gain(patch.reference)[..., None]
    return FieldLight(
        source=source,
        patch=patch,
        step_rule=SURFACE.field_step,
        field=field,
        blur_px=optics.require_optics(source).blur_px,
    )


class FieldFit(NamedTuple):
    """A shading field by some touches."""

    coefficients: Doubles  # (m,) posterior mean
    precision: Doubles  # (m, m) of the posterior
    misfit: float  # grey levels, summed over the touches


def determines_field(patch: ImagePatch) -> bool:
    """Whether enough of a patch has changed to determine a shading field."""
    return int(np.count_nonzero(_find_clear_cells(patch)[1])) >= LIGHT.min_field_samples


def fit_field(
    source: SensorSpec, touches: Sequence[TouchObservation], described_misfit: float = math.inf
) -> FieldFit | None:
    """The one shading field that some touches determine together, from first guesses of their
    surfaces.

    None where the field will not explain far more than described light, which leaves
    `described_misfit`.
    """
    prior = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
    coefficients, precision = prior.mean, prior.precision
    surfaces = [touch.surface_mm for touch in touches]
    refinements = LIGHT.first_field_refinements
    misfit = 0.0
    iterations = LIGHT.field_iterations if len(touches) == 1 else LIGHT.joint_field_iterations
    for iteration in range(iterations + 1):
        lights = [make_field_light(coefficients, touch.patch, source) for touch in touches]
        refined = [
            refine_surface(z, touch.patch, light, touch.integrate, refinements, SURFACE)
            for z, touch, light in zip(surfaces, touches, lights, strict=True)
        ]
        misfit = sum(left for _, left in refined)
        if iteration and described_misfit <= LIGHT.hopeless_field_gain * misfit:
            return None
        if iteration == iterations:
            break
        depths = [
            estimate_likeliest_depth(
                prior, functools.partial(_sample_surface, z, light, *_find_clear_cells(light.patch))
            )
            for (z, _), light in zip(refined, lights, strict=True)
        ]
        coefficients, precision = compute_posterior(prior, [sums for _, sums in depths])
        surfaces = [z * np.float32(f) for (z, _), (f, _) in zip(refined, depths, strict=True)]
        refinements = LIGHT.fit_refinements
    return FieldFit(coefficients, precision, misfit)


def sum_covariance(precision: Doubles) -> Doubles:
    """Covariance of the terms of a field (n, n), summed over the colours, by its precision."""
    block = N_POSITION_TERMS * N_SHADING_TERMS
    covariance = np.linalg.inv(precision).reshape(3, block, 3, block)
    return np.asarray(np.einsum("kikj->ij", covariance), np.float64)


def compute_known_share(
    field: Illumination, dent_mm: Floats, source: SensorSpec, pixel_mm: float
) -> float:
    """How well a recording's field is known where a coarse dent (rows, cols) is: from 0 to 1 =
    needs no fit of its own.

    By the standard deviation of the colours that the dent has in it, over these colours.
    """
    shape = source.camera.shape
    block = compute_block_px(shape)
    x, y = ((np.arange(n) + 0.5) * block - 0.5 for n in dent_mm.shape[::-1])
    u, v = slope_model.locate(x, y, shape)
    dent = np.array(dent_mm, np.float32)
    nothing = np.zeros((*dent.shape, 3), np.float32)
    slopes = compute_slopes(dent, block * pixel_mm)
    normal = _sum_products(DentSamples(u, v, *slopes, dent, nothing, dent > 0.0)).normal
    mean = np.array(field.parameters).reshape(3, -1)
    variance = float((np.array(field.covariance).reshape(normal.shape) * normal).sum())
    relative = math.sqrt(variance / max(float(((mean @ normal) * mean).sum()), 1e-12))
    known, unknown = LIGHT.field_known
    return min(max((unknown - relative) / (unknown - known), 0.0), 1.0)


class DentSamples(NamedTuple):
    """A dent of known shape and its colours, on a grid."""

    u: Floats  # (cols,) positions, as `slope_model.compute_positions` has them
    v: Floats  # (rows,)
    gx: Floats  # (rows, cols) mm/mm
    gy: Floats
    indentation_mm: Floats
    change: Floats  # (rows, cols, 3) q
    seen: Mask  # (rows, cols) the cells that count


class FieldSums(NamedTuple):
    """A dent's part of the normal equations of a field."""

    normal: Doubles  # (n, n) alike for each colour
    pull: Doubles  # (3 n,)
    energy: float  # weighted squared colours


def estimate_likeliest_depth(
    prior: ShadingFieldPrior, sample: Callable[[float], DentSamples]
) -> tuple[float, FieldSums]:
    """The factor of a surface's depth under which its colours are likeliest, and its sums there.

    `sample` returns the same cells and colours with the depth times a factor.
    """
    logs = np.log(LIGHT.field_depth_factors)
    unlikeliness = [
        _compute_unlikeliness(prior, _sum_products(sample(factor)))
        for factor in LIGHT.field_depth_factors
    ]
    bend, slope, _ = np.polyfit(logs, unlikeliness, 2)
    at = -0.5 * slope / bend if bend > 0.0 else logs[int(np.argmin(unlikeliness))]
    factor = math.exp(min(max(float(at), float(logs[0])), float(logs[-1])))
    return factor, _sum_products(sample(factor))


def expand_field(coefficients: Doubles, u: Floats, v: Floats) -> Floats:
    """The field (rows, cols, 3, N_SHADING_TERMS) at the columns `u` and rows `v`."""
    table = coefficients.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)
    n = POSITION_DEGREE + 1
    grid = np.zeros((n, n, 3, N_SHADING_TERMS), np.float32)
    of_u, of_v = _list_powers()
    grid[of_v, of_u] = table.transpose(1, 0, 2)
    along_u, along_v = (np.vander(w, n, increasing=True) for w in (u, v))
    # (rows, powers of u, colours x terms)
    rows = np.tensordot(along_v, grid, 1).reshape(len(v), n, -1)
    return np.asarray(along_u @ rows, np.float32).reshape(len(v), len(u), 3, N_SHADING_TERMS)


@derive_once
def _list_powers() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Powers of u and of v (N_POSITION_TERMS,) of the position terms, in the order of
    `shading_field.compute_position_terms`.
    """
    n = POSITION_DEGREE + 1
    powers = np.array([(i, j) for j in range(n) for i in range(n - j)], np.intp)
    return powers[:, 0], powers[:, 1]


def _sum_products(dent: DentSamples) -> FieldSums:
    """The normal equations are sums over cells of products of two position terms and two shading
    terms: products of positions are monomials again.
    """
    from pipeline.stages.depth.illumination.illumination_kernels import sum_field_products

    n = 2 * POSITION_DEGREE + 1
    sums = np.zeros((n, n, N_SHADING_TERMS + 3, N_SHADING_TERMS))
    line = np.empty((7 + 28, len(dent.u)), np.float32)
    energy, count = sum_field_products(*dent, line, sums)
    weight = LIGHT.field_independent_pixels / max(count, 1) / LIGHT.field_noise**2
    along_u, along_v = _list_powers()
    block = N_POSITION_TERMS * N_SHADING_TERMS
    pairs = sums[along_v + along_v[:, None], along_u + along_u[:, None], :N_SHADING_TERMS]
    seen = sums[along_v, along_u, N_SHADING_TERMS:]  # (positions, 3, shading)
    return FieldSums(
        normal=weight * pairs.transpose(0, 2, 1, 3).reshape(block, block),
        pull=weight * seen.transpose(1, 0, 2).ravel(),
        energy=weight * energy,
    )


def _add_sums(
    prior: ShadingFieldPrior, touches: Sequence[FieldSums]
) -> tuple[Doubles, Doubles, float]:
    """(precision (m, m), right side (m,), squared length) of the posterior's normal equations."""
    block = N_POSITION_TERMS * N_SHADING_TERMS
    precision = prior.precision.copy()
    right = prior.precision @ prior.mean
    energy = float(prior.mean @ right)
    colour = np.arange(3)
    for touch in touches:
        precision.reshape(3, block, 3, block)[colour, :, colour] += touch.normal
        right = right + touch.pull
        energy += touch.energy
    return precision, right, energy


def compute_posterior(
    prior: ShadingFieldPrior, touches: Sequence[FieldSums]
) -> tuple[Doubles, Doubles]:
    """(mean (m,), precision (m, m)) of the coefficients."""
    precision, right, _ = _add_sums(prior, touches)
    return np.asarray(np.linalg.solve(precision, right), np.float64), precision


def _compute_unlikeliness(prior: ShadingFieldPrior, touch: FieldSums) -> float:
    """-2 ln p of the colours up to a constant.

    One root of the bordered matrix [P', r; r', e] holds det P' and, in its corner, e - r' P'^-1 r.
    """
    precision, right, energy = _add_sums(prior, [touch])
    m = len(right)
    bordered = np.empty((m + 1, m + 1))
    bordered[:m, :m] = precision
    bordered[m, :m] = bordered[:m, m] = right
    bordered[m, m] = energy + 1.0  # positive by rounding as well
    root = np.diag(np.linalg.cholesky(bordered))
    return float(root[m] ** 2 + 2.0 * np.log(root[:m]).sum())


def _sample_surface(
    surface_mm: Floats, light: FieldLight, q: Floats, seen: Mask, factor: float
) -> DentSamples:
    """A surface whose depth is scaled by a factor, blurred as the recorded change is."""
    import cv2

    patch = light.patch
    width = max(
        SURFACE.no_blur_px, math.hypot(light.blur_px, patch.smoothing_px) / patch.downsampling
    )
    clipped = clip_surface(surface_mm * np.float32(factor), patch, light, SURFACE.bulge_mm)
    z = np.asarray(cv2.GaussianBlur(clipped, (0, 0), width), np.float32)
    u, v = slope_model.locate(patch.x_px, patch.y_px, light.source.camera.shape)
    return DentSamples(u, v, *compute_slopes(z, patch.pixel_mm), z, q, seen)


def _find_clear_cells(patch: ImagePatch) -> tuple[Floats, Mask]:
    """Relative change q (rows, cols, 3), and the cells (rows, cols) in which it is no noise."""
    q = patch.change * slope_model.compute_gain(patch.reference)
    return q, patch.changed & (np.abs(q).max(axis=2) > LIGHT.min_relative_change)
