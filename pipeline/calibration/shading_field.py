"""How one unit's surface becomes colour, as a smooth field over its picture: what a few presses can settle.

Light of any number of lamps, near or far, falls on a dull surface so that each colour k of the relative change q
(`slope_model`) is linear in the unit normal n, as long as no lamp is hidden; and where the gel is pushed in by h it is
brighter or darker by itself, on recorded presses of all three gel sensors alike:

    q_k(p) = a_k(p) . (n(p) - z) + b_k(p) h(p)          a: one number per axis, b: per mm; polynomials of the place p

The four numbers of a place are one Gaussian unknown for the whole picture and all colours, known beforehand as far as
units differ (`near_lamps`), and pinned down where presses are. The look-up is the regression of slopes on the colours
that fields still possible would show, so that it leans on those colours that are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.calibration import slope_model
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples

POSITION_DEGREE = 4  # of the polynomials in u and v
N_POSITION_TERMS = (POSITION_DEGREE + 1) * (POSITION_DEGREE + 2) // 2
N_SHADING_TERMS = 4  # n - z along x, y and z, and h
_NOISE = 0.05  # of q: what the field cannot explain of a press
_WORTH = 40.0  # pixels that can be independent in one press: neighbours share its centre's error and the lens blur
_CLEAN = 0.15  # of q: a larger misfit is dust, a marker or a reflection, and pulls no harder
_COLOUR_DEGREE = 3  # of the look-up
_STEEPEST, _DEEPEST_MM = 0.9, 1.0  # what is sampled for it
_LEVEL_SHARE = 0.1  # of the samples: slopes without any indentation
_CAMERA_NOISE = 0.03  # of q, after smoothing


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceSamples:
    """Pixels whose surface is known: place, what the light depends on, and the colour seen."""

    u: Floats  # (n,)
    v: Floats  # (n,)
    shading_terms: Doubles  # (n, N_PARTS)
    change: Floats  # (n, 3) q


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadingFieldPrior:
    """Gaussian knowledge of a unit's field: coefficients (3, N_PLACES, N_PARTS), flattened."""

    mean: Doubles  # (m,)
    precision: Doubles  # (m, m)


def compute_shading_terms(slopes: Doubles, indentation_mm: Doubles) -> Doubles:
    """What the light depends on (n, N_PARTS), from slopes (n, 2) in mm/mm and indentation (n,)."""
    length = np.sqrt(1.0 + (slopes**2).sum(axis=1))
    return np.stack([-slopes[:, 0] / length, -slopes[:, 1] / length, 1.0 / length - 1.0, indentation_mm], axis=1)


def compute_position_terms(u: Floats | Doubles, v: Floats | Doubles) -> Doubles:
    """The monomials (n, N_PLACES) of the field's place."""
    n = range(POSITION_DEGREE + 1)
    return np.stack([np.asarray(u, np.float64) ** i * v**j for j in n for i in n if i + j <= POSITION_DEGREE], axis=1)


def update_field(before: ShadingFieldPrior, presses: Sequence[SurfaceSamples]) -> ShadingFieldPrior:
    """The field after the presses; each counts alike, and its pixels only as far as they are independent."""
    after = _updated(before, [(p, np.ones(len(p.u))) for p in presses])
    return _updated(before, [(p, _trust(after.mean, p)) for p in presses])


def predict_colours(coefficients: Doubles, at: Doubles, parts: Doubles) -> Doubles:
    """Q (n, 3) that a field of `coefficients` (m,) shows at `at` (n, N_PLACES)."""
    field = coefficients.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)
    return np.stack([((at @ field[k]) * parts).sum(axis=1) for k in range(3)], axis=1)


def sample_fields(fields: ShadingFieldPrior, count: int, rng: np.random.Generator) -> Doubles:
    """Fields (count, m) that are still possible."""
    root = np.linalg.cholesky(fields.precision)
    steps = np.linalg.solve(root.T, rng.normal(size=(len(fields.mean), count)))
    return (fields.mean[:, None] + steps).T


def fit_slope_model(candidates: Doubles, shape: tuple[int, int], count: int, rng: np.random.Generator) -> SlopeModel:
    """The look-up of a picture of `shape` from `candidates` (k, m), all fields that may be the unit's.

    `count` pixels anywhere, with slopes of any direction and size, are coloured by one field each.
    """
    u_all, v_all = slope_model.compute_positions(shape)
    u, v = rng.choice(u_all, count), rng.choice(v_all, count)
    angle, steep = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.0, _STEEPEST, count)
    slopes = np.stack([steep * np.cos(angle), steep * np.sin(angle)], axis=1)
    depth_mm = rng.uniform(0.0, _DEEPEST_MM, count) * (rng.random(count) > _LEVEL_SHARE)
    parts, at = compute_shading_terms(slopes, depth_mm), compute_position_terms(u, v)
    seen = _CAMERA_NOISE * rng.normal(size=(count, 3))
    for k, candidate in enumerate(candidates):
        mine = slice(k, None, len(candidates))
        seen[mine] += predict_colours(candidate, at[mine], parts[mine])
    samples = SlopeSamples(change=seen.astype(np.float32), u=u, v=v, slopes=slopes.astype(np.float32))
    return slope_model.fit(
        samples, np.ones(count, np.float32), colour_degree=_COLOUR_DEGREE, position_degree=POSITION_DEGREE, ridge=1e-6,
        huber=0.2,
    )  # fmt: skip


def _updated(before: ShadingFieldPrior, presses: Sequence[tuple[SurfaceSamples, Doubles]]) -> ShadingFieldPrior:
    block = N_POSITION_TERMS * N_SHADING_TERMS
    precision, pull = before.precision.copy(), before.precision @ before.mean
    for press, trust in presses:
        weight = trust * (_WORTH / max(len(trust), 1) / _NOISE**2)
        features = _features(press)
        weighted = features * weight[:, None]
        normal, target = weighted.T @ features, weighted.T @ press.change
        for k in range(3):
            mine = slice(k * block, (k + 1) * block)
            precision[mine, mine] += normal
            pull[mine] += target[:, k]
    return ShadingFieldPrior(mean=np.asarray(np.linalg.solve(precision, pull), np.float64), precision=precision)


def _trust(coefficients: Doubles, press: SurfaceSamples) -> Doubles:
    off = np.linalg.norm(
        predict_colours(coefficients, compute_position_terms(press.u, press.v), press.shading_terms) - press.change,
        axis=1,
    )
    return np.minimum(1.0, _CLEAN / np.maximum(off, 1e-9))


def _features(press: SurfaceSamples) -> Doubles:
    return (compute_position_terms(press.u, press.v)[:, :, None] * press.shading_terms[:, None, :]).reshape(
        len(press.u), -1
    )
