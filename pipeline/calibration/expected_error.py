"""What error a look-up from presses of balls is to be expected to have: foreseen, and corrected by what was held out.

The field of light that is left possible (`light_field`) says how wrong the look-up is anywhere in the picture, also
where no press was: virtual presses of the ball at places all over it are coloured by possible fields and measured with
the look-up. Presses that were held out tell how wrong it is where presses are, with all that the field knows nothing
of: circles that are a little off, and a gel that shines otherwise.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.base.arrays import Doubles, Mask, freeze
from pipeline.calibration import shading_field, slope_model
from pipeline.calibration.ball_samples import SlopeSamples
from pipeline.calibration.calibration_table import ExpectedError
from pipeline.calibration.corrections import HeldOutErrors, PressSet, compute_sphere_error
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.calibration.slope_model import SlopeModel

_DRAWS = 12
_PLACES = (5, 6)  # down and across
_COVERED = 24  # places along each side, for the share that presses cover
_MARGIN = 0.1  # of the picture: touches at its very border are measured badly by anything
_PIXELS = 60  # of a virtual press
_NEAR = 0.5  # halves of the picture from a press: within that three quarters of the light hang together
_WORTH = 4.0  # presses that what is foreseen counts as
_UNFORESEEN = 2.0  # times what is foreseen: circles that are off and light that is no such field
_ALWAYS = 0.03  # where the contact ends is not known better, however many presses: a real Mini, forty of them
_LEAST = 0.005  # a median of a few errors below this is luck
_FEWEST_COVERED = 0.5  # of the picture: with less, how it is read in the middle of its places is a guess
_MEDIAN_OF_MEAN = 0.845  # of the sizes of normal errors; the mean of a few is known better by a third


def simulate_errors(model: SlopeModel, fields: ShadingFieldPrior, known: PressSet) -> Doubles:
    """Diameter errors, as shares, of virtual presses of the ball: (draws, places)."""
    rng = np.random.default_rng(1)
    rows, cols = known.shape
    ball_px = known.ball.radius_px
    contact_px = float(np.median([p.circle.radius_px for p in known.presses]))
    u_all, v_all = slope_model.compute_positions(known.shape)
    y, x = (
        np.linspace(_MARGIN * (n - 1), (1 - _MARGIN) * (n - 1), k) for n, k in zip((rows, cols), _PLACES, strict=True)
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
    """The error to be expected of correction number `best`, in the middle of the picture's places.

    `virtual` is what is `foreseen` of it.
    """
    virtual = virtual.ravel()
    measured = np.array([]) if held is None else held.diameter_share[:, best]
    measured = measured[np.isfinite(measured)]
    return ExpectedError(
        diameter_share=_together(np.abs(virtual), np.abs(measured)),
        # How far a ball of known size is pushed in goes with the curvature that is measured.
        depth_share=_together(np.abs(1.0 / (1.0 + virtual) - 1.0), np.abs(1.0 / (1.0 + measured) - 1.0)),
        n_held_out=len(measured),
    )


def compute_coverage_map(virtual: Doubles, known: PressSet) -> Mask:
    """Places (down, across) where presses tell the light: one is near, and what is `foreseen` there is a ball."""
    rows, cols = known.shape
    down, across = (np.linspace(_MARGIN * n, (1 - _MARGIN) * n, k) for n, k in zip((rows, cols), _PLACES, strict=True))
    seen = np.median(np.abs(virtual), axis=0).reshape(_PLACES) < 1.0
    return freeze(np.asarray(seen & _near(known, *np.meshgrid(across, down)), np.bool_))


def has_low_coverage(known: PressSet) -> bool:
    """Whether too much of the picture is a guess."""
    return compute_coverage(known) < _FEWEST_COVERED


def compute_coverage(known: PressSet) -> float:
    """The share of the picture that lies near a press: in the rest the field of light is guessed."""
    rows, cols = known.shape
    x, y = np.meshgrid(np.arange(0.5, _COVERED) / _COVERED * cols, np.arange(0.5, _COVERED) / _COVERED * rows)
    return float(_near(known, x, y).mean())


def _near(known: PressSet, x_px: Doubles, y_px: Doubles) -> Mask:
    """Which places are near a press."""
    away = np.min([np.hypot(x_px - p.circle.x_px, y_px - p.circle.y_px) for p in known.presses], axis=0)
    return np.asarray(away < _NEAR * 0.5 * max(known.shape), np.bool_)


def summarise_errors(errors: Doubles) -> ExpectedError:
    """The error to be expected where a look-up that the presses did not make had these `errors` of their diameters."""

    def estimate_median(sizes: Doubles) -> float:
        return max(_MEDIAN_OF_MEAN * float(np.abs(sizes).mean()), _LEAST)

    return ExpectedError(
        diameter_share=estimate_median(errors),
        depth_share=estimate_median(1.0 / (1.0 + errors) - 1.0),
        n_held_out=len(errors),
    )


def _together(virtual: Doubles, measured: Doubles) -> float:
    """The middle of what was foreseen and of what was measured, in the logarithm: the more presses, the more theirs."""
    before = math.log(_UNFORESEEN * float(np.median(virtual)))
    if len(measured) == 0:
        return math.hypot(math.exp(before), _ALWAYS)
    after = math.log(max(float(np.median(measured)), _LEAST))
    return math.hypot(math.exp((_WORTH * before + len(measured) * after) / (_WORTH + len(measured))), _ALWAYS)
