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

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.calibration.shading_field import (
    N_POSITION_TERMS,
    N_SHADING_TERMS,
    POSITION_DEGREE,
    ShadingFieldPrior,
    SurfaceSamples,
)
from pipeline.core.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination.constants import CONSTANTS, FIELD_STEP
from pipeline.stages.depth.illumination.light import ImagePatch, Light, RenderedChange
from pipeline.stages.depth.illumination.surface_refinement import clip_surface, refine_surface
from pipeline.stages.depth.poisson import Integrator

_MIN_BLUR_PX = 0.3


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
        step_rule=FIELD_STEP,
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
    where = np.flatnonzero(patch.changed & (np.abs(q).max(axis=2) > CONSTANTS.min_relative_change))
    if len(where) < CONSTANTS.min_field_samples:
        return None
    prior = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
    light = make_field_light(prior.mean, patch, source)
    iterations = CONSTANTS.first_field_refinements
    surface_mm, misfit = refine_surface(surface_mm, patch, light, integrate, iterations)
    coefficients = prior.mean
    for _ in range(CONSTANTS.field_iterations):
        touch = functools.partial(_sample_surface, surface_mm, light, q, where)
        factor, coefficients = estimate_likeliest_depth(prior, touch)
        light = make_field_light(coefficients, patch, source)
        surface_mm, misfit = refine_surface(
            surface_mm * np.float32(factor), patch, light, integrate, CONSTANTS.field_refinements
        )
        if described_misfit <= CONSTANTS.hopeless_field_gain * misfit:
            return None
    return coefficients, misfit


def estimate_likeliest_depth(
    prior: ShadingFieldPrior, sample: Callable[[float], SurfaceSamples]
) -> tuple[float, Doubles]:
    """The factor of a surface's depth under which its colours are likeliest, and the field's
    coefficients (m,) there.

    `sample` returns the same pixels and colours with the depth times a factor.
    """
    logs = np.log(CONSTANTS.field_depth_factors)
    surfaces = [sample(factor) for factor in CONSTANTS.field_depth_factors]
    places = _compute_places(surfaces[0].u, surfaces[0].v)
    unlikeliness = [_compute_posterior(prior, surface, places)[0] for surface in surfaces]
    bend, slope, _ = np.polyfit(logs, unlikeliness, 2)
    at = -0.5 * slope / bend if bend > 0.0 else logs[int(np.argmin(unlikeliness))]
    factor = math.exp(min(max(float(at), float(logs[0])), float(logs[-1])))
    return factor, _compute_posterior(prior, sample(factor), places)[1]


def expand_field(coefficients: Doubles, u: Floats, v: Floats) -> Floats:
    """The field (rows, cols, 3, N_SHADING_TERMS) at the columns `u` and rows `v`."""
    table = coefficients.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)
    n = POSITION_DEGREE + 1
    grid = np.zeros((n, n, 3, N_SHADING_TERMS))
    for k, (i, j) in enumerate(_list_powers(POSITION_DEGREE)):
        grid[j, i] = table[:, k]
    along_u, along_v = (np.vander(w.astype(np.float64), n, increasing=True) for w in (u, v))
    # (rows, powers of u, colours x terms)
    rows = np.tensordot(along_v, grid, 1).reshape(len(v), n, -1)
    return np.asarray(along_u @ rows, np.float32).reshape(len(v), len(u), 3, N_SHADING_TERMS)


def _list_powers(degree: int) -> list[tuple[int, int]]:
    """Powers of u and v of the monomials up to a degree, in the order of
    `shading_field.compute_position_terms`.
    """
    return [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]


def _compute_places(u: Floats, v: Floats) -> Doubles:
    """Monomials of positions (n,), up to those of products of two position terms: (m, n)."""
    degree = 2 * POSITION_DEGREE
    of_u, of_v = (
        np.ascontiguousarray(np.vander(w.astype(np.float64), degree + 1, increasing=True).T)
        for w in (u, v)
    )
    return np.stack([of_u[i] * of_v[j] for i, j in _list_powers(degree)])


@functools.cache
def _index_products() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows in `_compute_places` of all position terms (m,) and of all products of two (m, m)."""
    number = {powers: k for k, powers in enumerate(_list_powers(2 * POSITION_DEGREE))}
    powers = _list_powers(POSITION_DEGREE)
    pairs = [[number[a + c, b + d] for c, d in powers] for a, b in powers]
    return np.array([number[p] for p in powers]), np.array(pairs)


def _compute_posterior(
    prior: ShadingFieldPrior, surface: SurfaceSamples, places: Doubles
) -> tuple[float, Doubles]:
    """(-2 ln p of the colours up to a constant, posterior mean of the coefficients).

    The normal equations are sums over pixels of products of two position terms and two shading
    terms: products of positions are monomials again, the same for every depth.
    """
    weight = CONSTANTS.field_independent_pixels / max(len(surface.u), 1) / CONSTANTS.field_noise**2
    single, pairs = _index_products()
    block = N_POSITION_TERMS * N_SHADING_TERMS
    terms = np.ascontiguousarray(surface.shading_terms.T)
    change = surface.change.T.astype(np.float64)
    first, second = np.triu_indices(N_SHADING_TERMS)
    products = np.concatenate(
        [terms[first] * terms[second], (terms[:, None] * change).reshape(-1, len(surface.u))]
    )
    sums = places @ products.T
    both = np.zeros((N_SHADING_TERMS, N_SHADING_TERMS), np.intp)
    both[first, second] = both[second, first] = np.arange(len(first))
    normal = sums[:, both][pairs].transpose(0, 2, 1, 3).reshape(block, block)
    seen = sums[single, len(first) :].reshape(block, 3)
    pull = prior.precision @ prior.mean
    unlikeliness = float(prior.mean @ pull) + weight * float((change**2).sum())
    precision = prior.precision.copy()
    for k in range(3):
        colour = slice(k * block, (k + 1) * block)
        precision[colour, colour] += weight * normal
    right = pull + weight * seen.T.ravel()
    coefficients = np.asarray(np.linalg.solve(precision, right), np.float64)
    log_root = np.log(np.diag(np.linalg.cholesky(precision)))
    return unlikeliness - float(right @ coefficients) + 2.0 * float(log_root.sum()), coefficients


def _sample_surface(
    surface_mm: Floats, light: FieldLight, q: Floats, where: NDArray[np.intp], factor: float
) -> SurfaceSamples:
    """The pixels `where` of a surface whose depth is scaled by a factor, blurred as the recorded
    change is.
    """
    import cv2

    patch = light.patch
    width = max(_MIN_BLUR_PX, math.hypot(light.blur_px, patch.smoothing_px) / patch.downsampling)
    z = np.asarray(
        cv2.GaussianBlur(
            clip_surface(surface_mm * np.float32(factor), patch, light), (0, 0), width
        ),
        np.float32,
    )
    u, v = _compute_positions(patch, light.source)
    row, col = np.divmod(where, z.shape[1])
    slopes = np.stack([g.ravel()[where] for g in compute_slopes(z, patch.pixel_mm)], axis=1).astype(
        np.float64
    )
    terms = shading_field.compute_shading_terms(slopes, z.ravel()[where].astype(np.float64))
    return SurfaceSamples(u=u[col], v=v[row], shading_terms=terms, change=q.reshape(-1, 3)[where])


def _compute_positions(patch: ImagePatch, source: SensorSpec) -> tuple[Floats, Floats]:
    """Positions (u, v) of the columns and rows, as `slope_model.compute_positions` has them."""
    rows, cols = source.camera.shape
    half = np.float32(0.5 * max(rows, cols))
    u = (patch.x_px - np.float32(0.5 * (cols - 1))) / half
    v = (patch.y_px - np.float32(0.5 * (rows - 1))) / half
    return u.astype(np.float32), v.astype(np.float32)
