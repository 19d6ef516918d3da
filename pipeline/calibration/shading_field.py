"""How an instance's surface becomes colour, as a smooth field over its image that a few
indentations can determine.

Light of any number of LEDs, near or far, falls on a matt surface so that each colour k of the
relative change q (`slope_model`) is linear in the unit normal n, as long as no LED is hidden; where
the gel is indented by h it is brighter or darker by itself, on recorded indentations of all three
gel sensors alike:

    q_k(p) = a_k(p) . (n(p) - e_z) + b_k(p) h(p)        a: one number per axis, b: per mm;
                                                        polynomials of position p

The four numbers of a place are one Gaussian unknown for the whole image and all colours, with the
variation between instances as prior (`near_led_prior`), and determined where indentations are. The
calibration table is the regression of slopes on the colours that fields still possible would show,
so that it relies on the colours that are known.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.calibration import slope_model
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.core.arrays import Doubles, Floats
from pipeline.core.frozen import frozen

POSITION_DEGREE = 4  # of the polynomials in u and v
N_POSITION_TERMS = (POSITION_DEGREE + 1) * (POSITION_DEGREE + 2) // 2
N_SHADING_TERMS = 4  # n - e_z along x, y and z, and h
_NOISE = 0.05  # of q: what the field cannot explain of an indentation
# of one indentation: neighbours share its centre's error and the lens blur
_INDEPENDENT_PIXELS = 40.0
_HUBER = 0.15  # of q: larger residuals are dust, a marker or a reflection
_COLOUR_DEGREE = 3  # of the calibration table
# mm/mm and mm, of the samples for the table
_MAX_SLOPE = 0.9
_MAX_DEPTH_MM = 1.0
_LEVEL_SHARE = 0.1  # of the samples, with slopes but no indentation
_CAMERA_NOISE = 0.03  # of q, after smoothing


@frozen
class SurfaceSamples:
    """Pixels of a known surface: position, terms of the light, and recorded colour."""

    u: Floats  # (n,)
    v: Floats  # (n,)
    shading_terms: Doubles  # (n, N_SHADING_TERMS)
    change: Floats  # (n, 3) q


@frozen
class ShadingFieldPrior:
    """Gaussian of an instance's field: coefficients (3, N_POSITION_TERMS, N_SHADING_TERMS),
    flattened.
    """

    mean: Doubles  # (m,)
    precision: Doubles  # (m, m)


def compute_shading_terms(slopes: Doubles, indentation_mm: Doubles) -> Doubles:
    """Terms of the light (n, N_SHADING_TERMS) of slopes (n, 2) in mm/mm and indentations (n,) in
    mm.
    """
    length = np.sqrt(1.0 + (slopes**2).sum(axis=1))
    return np.stack(
        [-slopes[:, 0] / length, -slopes[:, 1] / length, 1.0 / length - 1.0, indentation_mm]
    ).T


def compute_position_terms(u: Floats | Doubles, v: Floats | Doubles) -> Doubles:
    """The monomials (n, N_POSITION_TERMS) of positions (n,) in the image."""
    n = range(POSITION_DEGREE + 1)
    of_u, of_v = (
        np.ascontiguousarray(np.vander(w.astype(np.float64), len(n), increasing=True).T)
        for w in (u, v)
    )
    return np.stack([of_u[i] * of_v[j] for j in n for i in n if i + j <= POSITION_DEGREE]).T


def update_field(before: ShadingFieldPrior, presses: Sequence[SurfaceSamples]) -> ShadingFieldPrior:
    """The field after indentations, which all count alike."""
    after = _update(before, [(p, np.ones(len(p.u))) for p in presses])
    return _update(before, [(p, _compute_weights(after.mean, p)) for p in presses])


def predict_colours(coefficients: Doubles, at: Doubles, parts: Doubles) -> Doubles:
    """Colours q (n, 3) of a field of `coefficients` (m,) at positions `at` (n,
    N_POSITION_TERMS).
    """
    field = coefficients.reshape(3, N_POSITION_TERMS, N_SHADING_TERMS)
    return np.stack([((at @ field[k]) * parts).sum(axis=1) for k in range(3)], axis=1)


def sample_fields(fields: ShadingFieldPrior, count: int, rng: np.random.Generator) -> Doubles:
    """Random fields (count, m)."""
    root = np.linalg.cholesky(fields.precision)
    steps = np.linalg.solve(root.T, rng.normal(size=(len(fields.mean), count)))
    return (fields.mean[:, None] + steps).T


def fit_slope_model(
    candidates: Doubles, shape: tuple[int, int], count: int, rng: np.random.Generator
) -> SlopeModel:
    """The slope model of an image of `shape` (rows, cols) from `candidates` (k, m), fields of
    possible instances.

    Each of `count` random pixels, with a random slope, is coloured by one of the fields.
    """
    u_all, v_all = slope_model.compute_positions(shape)
    u = rng.choice(u_all, count)
    v = rng.choice(v_all, count)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    steep = rng.uniform(0.0, _MAX_SLOPE, count)
    slopes = np.stack([steep * np.cos(angle), steep * np.sin(angle)], axis=1)
    depth_mm = rng.uniform(0.0, _MAX_DEPTH_MM, count) * (rng.random(count) > _LEVEL_SHARE)
    parts = compute_shading_terms(slopes, depth_mm)
    at = compute_position_terms(u, v)
    colours = _CAMERA_NOISE * rng.normal(size=(count, 3))
    for k, candidate in enumerate(candidates):
        part = slice(k, None, len(candidates))
        colours[part] += predict_colours(candidate, at[part], parts[part])
    samples = SlopeSamples(
        change=colours.astype(np.float32), u=u, v=v, slopes=slopes.astype(np.float32)
    )
    return slope_model.fit(
        samples,
        colour_degree=_COLOUR_DEGREE,
        position_degree=POSITION_DEGREE,
        ridge=1e-6,
        huber=0.2,
    )


def _update(
    before: ShadingFieldPrior, presses: Sequence[tuple[SurfaceSamples, Doubles]]
) -> ShadingFieldPrior:
    block = N_POSITION_TERMS * N_SHADING_TERMS
    precision = before.precision.copy()
    pull = before.precision @ before.mean
    for press, trust in presses:
        weight = trust * (_INDEPENDENT_PIXELS / max(len(trust), 1) / _NOISE**2)
        features = compute_features(press)
        weighted = features * weight[:, None]
        normal = weighted.T @ features
        target = weighted.T @ press.change
        for k in range(3):
            part = slice(k * block, (k + 1) * block)
            precision[part, part] += normal
            pull[part] += target[:, k]
    return ShadingFieldPrior(
        mean=np.asarray(np.linalg.solve(precision, pull), np.float64), precision=precision
    )


def _compute_weights(coefficients: Doubles, press: SurfaceSamples) -> Doubles:
    off = np.linalg.norm(
        predict_colours(coefficients, compute_position_terms(press.u, press.v), press.shading_terms)
        - press.change,
        axis=1,
    )
    return np.minimum(1.0, _HUBER / np.maximum(off, 1e-9))


def compute_features(press: SurfaceSamples) -> Doubles:
    """What a colour of each pixel is linear in (n, N_POSITION_TERMS x N_SHADING_TERMS), a term
    at a time in memory.
    """
    at = compute_position_terms(press.u, press.v).T
    terms = press.shading_terms.T
    return (at[:, None] * terms).reshape(-1, len(press.u)).T
