"""Expected error of a calibration table from presses of a ball: predicted, then corrected by held-out presses.

The posterior of the shading field (`shading_field`) predicts the error anywhere in the image, also far from presses:
virtual presses of the ball on a grid are rendered under sampled fields and measured with the table. Held-out presses
measure the error where presses are, with everything that the field does not model: inexact circles, other reflectance.
"""

import math

import numpy as np

from pipeline.base.arrays import Doubles, Mask, freeze
from pipeline.calibration import shading_field, slope_model
from pipeline.calibration.ball_samples import SlopeSamples
from pipeline.calibration.calibration_table import P90_OVER_STD, USUAL_STD, ExpectedError
from pipeline.calibration.corrections import HeldOutErrors, PressSet, compute_sphere_error
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.calibration.slope_model import SlopeModel

_DRAWS = 12
_GRID = (5, 6)  # virtual presses, down and across
_COVERAGE_GRID = 24  # points along each side, for the share that presses cover
_MARGIN = 0.1  # of the image: no table measures touches at its very border well
_PIXELS = 60  # of a virtual press
_NEAR_SHARE = 0.5  # half-widths of the image from a press: within this, light correlates by three quarters
_PRIOR_PRESSES = 4.0  # presses that the prediction counts as
_PREDICTION_FACTOR = 2.0  # on the prediction: inexact circles and light that the field does not model
_ERROR_FLOOR = 0.03  # uncertainty of the contact's edge, however many presses: forty of a real Mini
_MEDIAN_MIN = 0.005  # smaller medians of a few errors are chance
_COVERAGE_MIN = 0.5  # of the image: with less, the error elsewhere is unknown
_PERCENTILES = (50.0, 90.0)  # that are stated
_STD_OVER_MEAN = 1.253  # standard deviation of normal errors over the mean of their sizes
_MEDIAN_OVER_MEAN = 0.845  # of the sizes of normal errors; the mean of a few is more certain by a third


def simulate_errors(model: SlopeModel, fields: ShadingFieldPrior, known: PressSet) -> Doubles:
    """Relative diameter errors of virtual presses of the ball: (draws, places)."""
    rng = np.random.default_rng(1)
    rows, cols = known.shape
    ball_px = known.ball.radius_px
    contact_px = float(np.median([p.circle.radius_px for p in known.presses]))
    u_all, v_all = slope_model.compute_positions(known.shape)
    y, x = (
        np.linspace(_MARGIN * (n - 1), (1 - _MARGIN) * (n - 1), k) for n, k in zip((rows, cols), _GRID, strict=True)
    )
    r, turn = contact_px * np.sqrt(rng.random(_PIXELS)), rng.uniform(0.0, 2.0 * math.pi, _PIXELS)
    dx, dy = r * np.cos(turn), r * np.sin(turn)
    slopes = -np.stack([dx, dy], axis=1) / np.sqrt(ball_px**2 - r**2)[:, None]
    parts = shading_field.compute_shading_terms(slopes, (contact_px**2 - 0.5 * r**2) / ball_px * known.pixel_mm)
    unit = float(u_all[1] - u_all[0])
    out = np.empty((_DRAWS, len(y) * len(x)))
    candidates = shading_field.sample_fields(fields, _DRAWS, rng)
    for place, (cy, cx) in enumerate((a, b) for a in y for b in x):
        u = (u_all[0] + unit * (cx + dx)).astype(np.float32)
        v = (v_all[0] + unit * (cy + dy)).astype(np.float32)
        at = shading_field.compute_position_terms(u, v)
        for k, candidate in enumerate(candidates):
            seen = shading_field.predict_colours(candidate, at, parts).astype(np.float32)
            measured = slope_model.predict(model, SlopeSamples(change=seen, u=u, v=v, slopes=slopes.astype(np.float32)))
            out[k, place] = compute_sphere_error(measured, slopes)
    return out


def estimate_expected_error(virtual: Doubles, held: HeldOutErrors | None, best: int) -> ExpectedError:
    """The expected error of correction number `best` over the image.

    `virtual`: its errors of `simulate_errors`.
    """
    virtual = virtual.ravel()
    measured = np.array([]) if held is None else held.diameter_share[:, best]
    measured = measured[np.isfinite(measured)]
    # The indentation of a ball of known size is proportional to the measured curvature.
    virtual_depth, measured_depth = (1.0 / (1.0 + errors) - 1.0 for errors in (virtual, measured))
    diameter, depth = ([_combine_errors(np.abs(predicted), np.abs(held_out), percent) for percent in _PERCENTILES]
                       for predicted, held_out in ((virtual, measured), (virtual_depth, measured_depth)))  # fmt: skip
    return ExpectedError(diameter_share=diameter[0], diameter_p90=diameter[1], depth_share=depth[0],
                         depth_p90=depth[1], n_held_out=len(measured))  # fmt: skip


def compute_coverage_map(virtual: Doubles, known: PressSet) -> Mask:
    """Places (down, across) that the presses cover: one is near, and a virtual ball there is detected."""
    rows, cols = known.shape
    down, across = (np.linspace(_MARGIN * n, (1 - _MARGIN) * n, k) for n, k in zip((rows, cols), _GRID, strict=True))
    seen = np.median(np.abs(virtual), axis=0).reshape(_GRID) < 1.0
    return freeze(np.asarray(seen & _is_near_press(known, *np.meshgrid(across, down)), np.bool_))


def has_low_coverage(known: PressSet) -> bool:
    """Whether too little of the image is near a press; elsewhere the shading field is a guess."""
    rows, cols = known.shape
    x, y = np.meshgrid(
        np.arange(0.5, _COVERAGE_GRID) / _COVERAGE_GRID * cols, np.arange(0.5, _COVERAGE_GRID) / _COVERAGE_GRID * rows
    )
    return float(_is_near_press(known, x, y).mean()) < _COVERAGE_MIN


def _is_near_press(known: PressSet, x_px: Doubles, y_px: Doubles) -> Mask:
    away = np.min([np.hypot(x_px - p.circle.x_px, y_px - p.circle.y_px) for p in known.presses], axis=0)
    return np.asarray(away < _NEAR_SHARE * 0.5 * max(known.shape), np.bool_)


def summarise_errors(errors: Doubles) -> ExpectedError:
    """The expected error of a table that is independent of the presses, from their relative diameter `errors`."""

    def estimate_median(sizes: Doubles) -> float:
        return max(_MEDIAN_OVER_MEAN * float(np.abs(sizes).mean()), _MEDIAN_MIN)

    def estimate_p90(sizes: Doubles) -> float:
        n = len(sizes)  # few presses seldom include the largest errors
        mean = _STD_OVER_MEAN * float(np.abs(sizes).sum())
        return P90_OVER_STD * (_PRIOR_PRESSES * USUAL_STD + mean) / (_PRIOR_PRESSES + n)

    depth = 1.0 / (1.0 + errors) - 1.0
    return ExpectedError(
        diameter_share=estimate_median(errors), diameter_p90=estimate_p90(errors), depth_share=estimate_median(depth),
        depth_p90=estimate_p90(depth), n_held_out=len(errors),
    )  # fmt: skip


def _combine_errors(virtual: Doubles, measured: Doubles, percent: float) -> float:
    """Weighted log mean of a percentile of predicted and measured errors: more presses, more weight of the measured."""
    before = math.log(_PREDICTION_FACTOR * float(np.percentile(virtual, percent)))
    if len(measured) == 0:
        return math.hypot(math.exp(before), _ERROR_FLOOR)
    after = math.log(max(float(np.percentile(measured, percent)), _MEDIAN_MIN))
    return math.hypot(
        math.exp((_PRIOR_PRESSES * before + len(measured) * after) / (_PRIOR_PRESSES + len(measured))), _ERROR_FLOOR
    )
