"""Light of LEDs close to the gel as a smooth shading field, and its fit to one touch.

Close LEDs change the colours differently from instance to instance, and many times over within one image: next to a LED
a slope hardly changes its colour. Each colour k of the relative change q (`slope_model`) is linear in the normal n and
the indentation z, q_k(p) = a_k(p) . (n - e_z) + b_k(p) z, with smooth fields a, b (`calibration.shading_field`).

A touch that is at rest all around determines how the changes of its colours relate to each other, for its slopes have
to be those of one surface; but a deeper surface in weaker light looks the same. How deep it is then follows from how
likely such light is (`near_led_prior`). Of surfaces of one shape, that of the depth with the likeliest colours is taken
(the vertex of a parabola through three depths): it moves with the colours, without a jump,

    -2 ln p(q) = sum w q^2 + m' P m - b' P'^-1 b + ln det P',     P' = P + sum w f f',   b = P m + sum w f q

with m and P the mean and precision of the prior, f what a pixel's light depends on and w its weight.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats
from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.calibration.shading_field import (
    N_POSITION_TERMS,
    N_SHADING_TERMS,
    POSITION_DEGREE,
    ShadingFieldPrior,
    SurfaceSamples,
)
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
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
        source=source, patch=patch, step_rule=FIELD_STEP, field=field,
        confidence=patch.unmarked_share,
        blur_px=optics.require_optics(source).blur_px, max_depth_mm=source.limits.indentation_max_mm,
    )  # fmt: skip


def fit_field(
    surface_mm: Floats, patch: ImagePatch, source: SensorSpec, integrate: Integrator, described_misfit: float = math.inf
) -> tuple[Doubles, float] | None:
    """Coefficients (m,) of the shading field that a touch determines, from a first guess of its surface; the misfit.

    None where too few pixels have changed, and where the field will not explain far more than described light does.
    """
    q = patch.change * slope_model.compute_gain(patch.reference)
    where = np.flatnonzero(patch.changed & (np.abs(q).max(axis=2) > CONSTANTS.min_relative_change))
    if len(where) < CONSTANTS.min_field_samples:
        return None
    prior = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
    light, iterations = make_field_light(prior.mean, patch, source), CONSTANTS.first_field_refinements
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
    """The factor of a surface's depth under which its colours are likeliest, and the field's coefficients (m,) there.

    `sample` returns the same pixels and colours with the depth times a factor.
    """
    logs = np.log(CONSTANTS.field_depth_factors)
    unlikeliness = [_compute_posterior(prior, sample(factor))[0] for factor in CONSTANTS.field_depth_factors]
    bend, slope, _ = np.polyfit(logs, unlikeliness, 2)
    at = -0.5 * slope / bend if bend > 0.0 else logs[int(np.argmin(unlikeliness))]
    factor = math.exp(min(max(float(at), float(logs[0])), float(logs[-1])))
    return factor, _compute_posterior(prior, sample(factor))[1]


def expand_field(coefficients: Doubles, u: Floats, v: Floats) -> Floats:
    """The field (rows, cols, 3, N_SHADING_TERMS) at the columns `u` and rows `v`."""
    table = coefficients.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)
    grid = np.zeros((3, N_SHADING_TERMS, POSITION_DEGREE + 1, POSITION_DEGREE + 1))
    n = range(POSITION_DEGREE + 1)
    powers = [(j, i) for j in n for i in n if i + j <= POSITION_DEGREE]  # as `shading_field.compute_position_terms`
    for k, (j, i) in enumerate(powers):
        grid[:, :, j, i] = table[:, k]
    along_u, along_v = (np.vander(w.astype(np.float64), POSITION_DEGREE + 1, increasing=True) for w in (u, v))
    field = np.einsum("rj,kpji,ci->rckp", along_v, grid, along_u, optimize=True)
    return np.ascontiguousarray(field, np.float32)


def _compute_posterior(prior: ShadingFieldPrior, surface: SurfaceSamples) -> tuple[float, Doubles]:
    """(-2 ln p of the colours up to a constant, posterior mean of the coefficients)."""
    weight = CONSTANTS.field_independent_pixels / max(len(surface.u), 1) / CONSTANTS.field_noise**2
    features = shading_field.compute_features(surface)
    pull = prior.precision @ prior.mean
    unlikeliness = float(prior.mean @ pull) + weight * float((surface.change.astype(np.float64) ** 2).sum())
    precision, block = prior.precision.copy(), features.shape[1]
    normal = weight * (features.T @ features)
    for k in range(3):
        colour = slice(k * block, (k + 1) * block)
        precision[colour, colour] += normal
    right = pull + weight * (features.T @ surface.change).T.ravel()
    coefficients = np.asarray(np.linalg.solve(precision, right), np.float64)
    log_root = np.log(np.diag(np.linalg.cholesky(precision)))
    return unlikeliness - float(right @ coefficients) + 2.0 * float(log_root.sum()), coefficients


def _sample_surface(
    surface_mm: Floats, light: FieldLight, q: Floats, where: NDArray[np.intp], factor: float
) -> SurfaceSamples:
    """The pixels `where` of a surface whose depth is scaled by a factor, blurred as the recorded change is."""
    import cv2

    patch = light.patch
    width = max(_MIN_BLUR_PX, math.hypot(light.blur_px, patch.smoothing_px) / patch.downsampling)
    z = np.asarray(
        cv2.GaussianBlur(clip_surface(surface_mm * np.float32(factor), patch, light), (0, 0), width), np.float32
    )
    u, v = _compute_positions(patch, light.source)
    row, col = np.divmod(where, z.shape[1])
    slopes = np.stack([g.ravel()[where] for g in compute_slopes(z, patch.pixel_mm)], axis=1).astype(np.float64)
    terms = shading_field.compute_shading_terms(slopes, z.ravel()[where].astype(np.float64))
    return SurfaceSamples(u=u[col], v=v[row], shading_terms=terms, change=q.reshape(-1, 3)[where])


def _compute_positions(patch: ImagePatch, source: SensorSpec) -> tuple[Floats, Floats]:
    """Positions (u, v) of the columns and rows, as `slope_model.compute_positions` has them."""
    rows, cols = source.camera.shape
    half = np.float32(0.5 * max(rows, cols))
    u, v = (patch.x_px - np.float32(0.5 * (cols - 1))) / half, (patch.y_px - np.float32(0.5 * (rows - 1))) / half
    return u.astype(np.float32), v.astype(np.float32)
