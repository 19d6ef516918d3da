"""What is taken of a correction: all that is sure, nothing where physics is as good, and no edge of its own."""

import numpy as np
import pytest

from pipeline.networks.residual_denoiser import ResidualDenoiser
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch.confidence_weighting import (
    ErrorCalibration,
    compute_wiener_gain,
    express_as_correction,
    read_error_calibration,
    shrink_to_prior,
)
from pipeline.stages.touch.physical_render import make_reference_touch
from pipeline.stages.touch.residual_diffusion import DenoisingState, ResidualSample

SHAPE = (24, 32)
LEFT = np.tile(np.arange(SHAPE[1]) < SHAPE[1] // 2, (SHAPE[0], 1))


def found(residual, spread):
    state = DenoisingState(
        sigma=0.0, residual_mm=np.full(SHAPE, np.float32(residual)), contact_correction=np.ones(SHAPE, np.float32)
    )
    return ResidualSample(
        final=state, expected_error_mm=np.full(SHAPE, np.float32(spread)), passes=1, states=(state,), notes=(),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("large", "off", "share"), [(1.0, 1.0, 0.5), (3.0, 1.0, 0.9), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0)]
)
def test_half_is_taken_of_what_is_as_large_as_its_error(large, off, share):
    assert np.allclose(compute_wiener_gain(np.full(SHAPE, large), np.full(SHAPE, off)), share, atol=1e-5)


def test_the_share_changes_less_from_pixel_to_pixel_than_what_it_is_taken_of():
    rng = np.random.default_rng(0)
    share = compute_wiener_gain(rng.normal(size=SHAPE), np.ones(SHAPE))
    assert np.abs(np.diff(share, axis=1)).max() < 0.1


def test_no_caution_takes_all_and_no_doubt_does_so_too():
    for caution, doubts in ((0.0, (1.0, 1.0)), (1.0, (0.0, 0.0))):
        kept = shrink_to_prior(
            found(2.0, 1.0), LEFT, caution, ErrorCalibration(factor_in_view=doubts[0], factor_outside=doubts[1])
        )
        assert np.allclose(kept.final.residual_mm, 2.0)


def test_what_the_source_felt_and_the_rest_are_doubted_apart_and_contact_less_beyond():
    kept = shrink_to_prior(found(2.0, 2.0), LEFT, 1.0, ErrorCalibration(factor_in_view=0.0, factor_outside=3.0))
    assert np.allclose(kept.final.residual_mm[:, 0], 2.0, atol=5e-3)
    assert np.allclose(kept.final.residual_mm[:, -1], 0.2, atol=5e-3)
    assert np.allclose(kept.final.contact_correction[:, 0], 1.0, atol=5e-3)
    assert np.allclose(kept.final.contact_correction[:, -1], np.sqrt(0.1), atol=5e-3)
    surer = shrink_to_prior(found(2.0, 2.0), LEFT, 1.0, ErrorCalibration(factor_in_view=3.0, factor_outside=3.0))
    assert np.allclose(surer.final.contact_correction[:, 0], 0.1, atol=5e-3)
    assert np.array_equal(kept.states[0].residual_mm, kept.final.residual_mm)


def test_by_a_power_little_told_is_nothing_and_much_is_more():
    squared = ErrorCalibration(factor_in_view=1.0, factor_outside=1.0, exponent=2.0, unit_mm=3.0)
    for told, off in ((0.3, 0.03), (3.0, 3.0), (6.0, 12.0)):
        assert np.allclose(squared.calibrate_error_mm(np.full(SHAPE, np.float32(told)), LEFT), off, rtol=1e-5)
    plain = ErrorCalibration(factor_in_view=1.0, factor_outside=1.0)
    little, much = ((found(2.0, told), LEFT, 1.0) for told in (0.3, 6.0))
    assert (
        shrink_to_prior(*little, squared).final.residual_mm.mean()
        > shrink_to_prior(*little, plain).final.residual_mm.mean()
    )
    assert (
        shrink_to_prior(*much, squared).final.residual_mm.mean()
        < shrink_to_prior(*much, plain).final.residual_mm.mean()
    )


def test_weights_that_tell_no_power_are_believed_in_proportion():
    net = ResidualDenoiser(
        inputs=3, unit_mm=3.0, base_channels=4, levels=2, error_factor_in_view=1.5, error_factor_outside=2.5
    )
    assert read_error_calibration(net) == ErrorCalibration(
        factor_in_view=1.5, factor_outside=2.5, exponent=1.0, unit_mm=3.0
    )


def test_where_the_source_felt_contact_may_stay_that_of_physics():
    kept = shrink_to_prior(
        found(2.0, 0.01), LEFT, 1.0, ErrorCalibration(factor_in_view=1.0, factor_outside=1.0), shrinks_contact=False
    )
    assert not kept.final.contact_correction[:, 0].any()
    assert np.allclose(kept.final.contact_correction[:, -1], 1.0, atol=1e-3)
    bold = shrink_to_prior(
        found(2.0, 0.01), LEFT, 0.0, ErrorCalibration(factor_in_view=1.0, factor_outside=1.0), shrinks_contact=False
    )
    assert (bold.final.contact_correction == 1.0).all(), "without caution all that the network says"


def test_a_touch_told_against_another_first_answer_is_the_same_touch():
    rest = make_reference_touch(load_sensor("soft_bubble")).membrane
    shape = rest.indentation_mm.shape
    state = DenoisingState(
        sigma=0.0, residual_mm=np.full(shape, np.float32(2.0)), contact_correction=np.ones(shape, np.float32)
    )
    one = ResidualSample(final=state, expected_error_mm=np.ones(shape, np.float32), passes=1, states=(state,), notes=())
    deeper = type(rest)(
        indentation_mm=np.full(shape, np.float32(0.5)), depth_mm=rest.depth_mm, contact=np.ones(shape, bool),
        camera=rest.camera, source_index=rest.source_index,
    )  # fmt: skip
    told = express_as_correction(one, deeper)
    assert np.allclose(told.final.residual_mm, 1.5)
    assert not told.final.contact_correction.any()
    assert np.allclose(told.states[0].residual_mm, 1.5)
