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
from collections.abc import Callable
from dataclasses import dataclass
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
from pipeline.physics import optics
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import LIGHT, SURFACE
from pipeline.stages.depth.illumination.light import ImagePatch, Light, RenderedChange
from pipeline.stages.depth.illumination.surface_refinement import clip_surface, refine_surface
from pipeline.stages.depth.poisson import Integrator


@dataclass(frozen=True, slots=True, kw_only=True)
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
    field = expand_field(coefficients, *_compute_positions(patch, source))
    field /= slope_model.compute_gain(patch.reference)[..., None]
    return FieldLight(
        source=source,
        patch=patch,
        step_rule=SURFACE.field_step,
        field=field,
        blur_px=optics.require_optics(source).blur_px,
    )


def fit_field(
    surface_mm: Floats,
    patch: ImagePatch,
    source: SensorSpec,
    integrate: Integrator,
    described_misfit: float = math.inf,
) -> tuple[Doubles, float] | None:
    """Coefficients (m,) of the shading field that a touch determines, from a first guess of its
    surface; the misfit.

    None where too few pixels have changed, and where the field will not explain far more than
    described light does.
    """
    q = patch.change * slope_model.compute_gain(patch.reference)
    seen = patch.changed & (np.abs(q).max(axis=2) > LIGHT.min_relative_change)
    if np.count_nonzero(seen) < LIGHT.min_field_samples:
        return None
    prior = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
    light = make_field_light(prior.mean, patch, source)
    iterations = LIGHT.first_field_refinements
    surface_mm, misfit = refine_surface(surface_mm, patch, light, integrate, iterations, SURFACE)
    coefficients = prior.mean
    for _ in range(LIGHT.field_iterations):
        touch = functools.partial(_sample_surface, surface_mm, light, q, seen)
        factor, coefficients = estimate_likeliest_depth(prior, touch)
        light = make_field_light(coefficients, patch, source)
        surface_mm, misfit = refine_surface(
            surface_mm * np.float32(factor), patch, light, integrate, LIGHT.fit_refinements, SURFACE
        )
        if described_misfit <= LIGHT.hopeless_field_gain * misfit:
            return None
    return coefficients, misfit


class DentSamples(NamedTuple):
    """A dent of known shape and its colours, on a grid."""

    u: Floats  # (cols,) positions, as `slope_model.compute_positions` has them
    v: Floats  # (rows,)
    gx: Floats  # (rows, cols) mm/mm
    gy: Floats
    indentation_mm: Floats
    change: Floats  # (rows, cols, 3) q
    seen: Mask  # (rows, cols) the cells that count


def estimate_likeliest_depth(
    prior: ShadingFieldPrior, sample: Callable[[float], DentSamples]
) -> tuple[float, Doubles]:
    """The factor of a surface's depth under which its colours are likeliest, and the field's
    coefficients (m,) there.

    `sample` returns the same cells and colours with the depth times a factor.
    """
    logs = np.log(LIGHT.field_depth_factors)
    unlikeliness = [
        _compute_posterior(prior, sample(factor))[0] for factor in LIGHT.field_depth_factors
    ]
    bend, slope, _ = np.polyfit(logs, unlikeliness, 2)
    at = -0.5 * slope / bend if bend > 0.0 else logs[int(np.argmin(unlikeliness))]
    factor = math.exp(min(max(float(at), float(logs[0])), float(logs[-1])))
    return factor, _compute_posterior(prior, sample(factor))[1]


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


@functools.cache
def _list_powers() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Powers of u and of v (N_POSITION_TERMS,) of the position terms, in the order of
    `shading_field.compute_position_terms`.
    """
    n = POSITION_DEGREE + 1
    powers = np.array([(i, j) for j in range(n) for i in range(n - j)], np.intp)
    return powers[:, 0], powers[:, 1]


def _compute_posterior(prior: ShadingFieldPrior, dent: DentSamples) -> tuple[float, Doubles]:
    """(-2 ln p of the colours up to a constant, posterior mean of the coefficients).

    The normal equations are sums over cells of products of two position terms and two shading
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
    normal = pairs.transpose(0, 2, 1, 3).reshape(block, block)
    seen = sums[along_v, along_u, N_SHADING_TERMS:]  # (positions, 3, shading)
    pull = prior.precision @ prior.mean
    right = pull + weight * seen.transpose(1, 0, 2).ravel()
    precision = prior.precision.copy()
    colour = np.arange(3)
    precision.reshape(3, block, 3, block)[colour, :, colour] += weight * normal
    coefficients = np.asarray(np.linalg.solve(precision, right), np.float64)
    log_root = np.log(np.diag(np.linalg.cholesky(precision)))
    unlikeliness = float(prior.mean @ pull) + weight * energy
    return unlikeliness - float(right @ coefficients) + 2.0 * float(log_root.sum()), coefficients


def _sample_surface(
    surface_mm: Floats, light: FieldLight, q: Floats, seen: Mask, factor: float
) -> DentSamples:
    """A surface whose depth is scaled by a factor, blurred as the recorded change is."""
    import cv2

    patch = light.patch
    width = max(
        SURFACE.no_blur_px, math.hypot(light.blur_px, patch.smoothing_px) / patch.downsampling
    )
    z = np.asarray(
        cv2.GaussianBlur(
            clip_surface(surface_mm * np.float32(factor), patch, light, SURFACE.bulge_mm),
            (0, 0),
            width,
        ),
        np.float32,
    )
    u, v = _compute_positions(patch, light.source)
    return DentSamples(u, v, *compute_slopes(z, patch.pixel_mm), z, q, seen)


def _compute_positions(patch: ImagePatch, source: SensorSpec) -> tuple[Floats, Floats]:
    """Positions (u, v) of the columns and rows, as `slope_model.compute_positions` has them."""
    rows, cols = source.camera.shape
    half = np.float32(0.5 * max(rows, cols))
    u = (patch.x_px - np.float32(0.5 * (cols - 1))) / half
    v = (patch.y_px - np.float32(0.5 * (rows - 1))) / half
    return u.astype(np.float32), v.astype(np.float32)
