"""Confidence weighting: certain corrections are shrunk, uncertain ones shrunk, without creating
edges.
"""

import numpy as np
import pytest

from pipeline.stages.networks.residual_denoiser import ResidualDenoiser
from pipeline.stages.touch.residual_diffusion import (
    DenoisingState,
    ErrorCalibration,
    ResidualSample,
    compute_wiener_gain,
    read_error_calibration,
    shrink_to_prior,
)

SHAPE = (24, 32)
LEFT = np.tile(np.arange(SHAPE[1]) < SHAPE[1] // 2, (SHAPE[0], 1))


def found(residual, spread):
    state = DenoisingState(
        sigma=0.0,
        residual_mm=np.full(SHAPE, np.float32(residual)),
        contact_correction=np.ones(SHAPE, np.float32),
    )
    return ResidualSample(
        final=state,
        expected_error_mm=np.full(SHAPE, np.float32(spread)),
        passes=1,
        states=(state,),
        notes=(),
    )


@pytest.mark.parametrize(
    ("large", "off", "share"), [(1.0, 1.0, 0.5), (3.0, 1.0, 0.9), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0)]
)
def test_a_correction_as_large_as_its_error_is_halved(large, off, share):
    assert np.allclose(
        compute_wiener_gain(np.full(SHAPE, large), np.full(SHAPE, off)), share, atol=1e-5
    )


def test_the_gain_is_smooth():
    rng = np.random.default_rng(0)
    share = compute_wiener_gain(rng.normal(size=SHAPE), np.ones(SHAPE))
    assert np.abs(np.diff(share, axis=1)).max() < 0.1


def test_weight_zero_and_error_zero_keep_the_full_correction():
    for weighting, factors in ((0.0, (1.0, 1.0)), (1.0, (0.0, 0.0))):
        shrunk = shrink_to_prior(
            found(2.0, 1.0),
            LEFT,
            weighting,
            ErrorCalibration(factor_in_view=factors[0], factor_outside=factors[1]),
        )
        assert np.allclose(shrunk.final.residual_mm, 2.0)


def test_view_and_outside_have_their_own_factors_and_contact_is_shrunk_less_outside():
    shrunk = shrink_to_prior(
        found(2.0, 2.0), LEFT, 1.0, ErrorCalibration(factor_in_view=0.0, factor_outside=3.0)
    )
    assert np.allclose(shrunk.final.residual_mm[:, 0], 2.0, atol=5e-3)
    assert np.allclose(shrunk.final.residual_mm[:, -1], 0.2, atol=5e-3)
    assert np.allclose(shrunk.final.contact_correction[:, 0], 1.0, atol=5e-3)
    assert np.allclose(shrunk.final.contact_correction[:, -1], np.sqrt(0.1), atol=5e-3)
    surer = shrink_to_prior(
        found(2.0, 2.0), LEFT, 1.0, ErrorCalibration(factor_in_view=3.0, factor_outside=3.0)
    )
    assert np.allclose(surer.final.contact_correction[:, 0], 0.1, atol=5e-3)
    assert np.array_equal(shrunk.states[0].residual_mm, shrunk.final.residual_mm)


def test_an_exponent_lowers_small_and_raises_large_errors():
    squared = ErrorCalibration(factor_in_view=1.0, factor_outside=1.0, exponent=2.0, unit_mm=3.0)
    for predicted, off in ((0.3, 0.03), (3.0, 3.0), (6.0, 12.0)):
        assert np.allclose(
            squared.calibrate_error_mm(np.full(SHAPE, np.float32(predicted)), LEFT), off, rtol=1e-5
        )
    plain = ErrorCalibration(factor_in_view=1.0, factor_outside=1.0)
    little, much = ((found(2.0, predicted), LEFT, 1.0) for predicted in (0.3, 6.0))
    assert (
        shrink_to_prior(*little, squared).final.residual_mm.mean()
        > shrink_to_prior(*little, plain).final.residual_mm.mean()
    )
    assert (
        shrink_to_prior(*much, squared).final.residual_mm.mean()
        < shrink_to_prior(*much, plain).final.residual_mm.mean()
    )


def test_the_default_exponent_is_one():
    net = ResidualDenoiser(
        inputs=3,
        unit_mm=3.0,
        base_channels=4,
        levels=2,
        error_factor_in_view=1.5,
        error_factor_outside=2.5,
    )
    assert read_error_calibration(net) == ErrorCalibration(
        factor_in_view=1.5, factor_outside=2.5, exponent=1.0, unit_mm=3.0
    )


def test_contact_in_view_can_be_kept_from_physics():
    shrunk = shrink_to_prior(
        found(2.0, 0.01),
        LEFT,
        1.0,
        ErrorCalibration(factor_in_view=1.0, factor_outside=1.0),
        shrinks_contact=False,
    )
    assert not shrunk.final.contact_correction[:, 0].any()
    assert np.allclose(shrunk.final.contact_correction[:, -1], 1.0, atol=1e-3)
    unweighted = shrink_to_prior(
        found(2.0, 0.01),
        LEFT,
        0.0,
        ErrorCalibration(factor_in_view=1.0, factor_outside=1.0),
        shrinks_contact=False,
    )
    assert (unweighted.final.contact_correction == 1.0).all(), "full correction of the network"
