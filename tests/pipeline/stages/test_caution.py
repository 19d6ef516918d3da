"""What is taken of a correction: all that is sure, nothing where physics is as good, and no edge of its own."""

import numpy as np
import pytest

from pipeline.networks.residual_denoiser import ResidualDenoiser
from pipeline.sensors.spec import sensor
from pipeline.stages.generate.caution import Trust, against, held_back, taken, trust
from pipeline.stages.generate.diffusion import Sampled, State
from pipeline.stages.generate.stage import at_rest

SHAPE = (24, 32)
LEFT = np.tile(np.arange(SHAPE[1]) < SHAPE[1] // 2, (SHAPE[0], 1))


def found(residual, spread):
    state = State(sigma=0.0, residual_mm=np.full(SHAPE, np.float32(residual)), contact=np.ones(SHAPE, np.float32))
    return Sampled(
        last=state, spread_mm=np.full(SHAPE, np.float32(spread)), passes=1, states=(state,), notes=(),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("large", "off", "share"), [(1.0, 1.0, 0.5), (3.0, 1.0, 0.9), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0)]
)
def test_half_is_taken_of_what_is_as_large_as_its_error(large, off, share):
    assert np.allclose(taken(np.full(SHAPE, large), np.full(SHAPE, off)), share, atol=1e-5)


def test_the_share_changes_less_from_pixel_to_pixel_than_what_it_is_taken_of():
    rng = np.random.default_rng(0)
    share = taken(rng.normal(size=SHAPE), np.ones(SHAPE))
    assert np.abs(np.diff(share, axis=1)).max() < 0.1


def test_no_caution_takes_all_and_no_doubt_does_so_too():
    for caution, doubts in ((0.0, (1.0, 1.0)), (1.0, (0.0, 0.0))):
        kept = held_back(found(2.0, 1.0), LEFT, caution, Trust(felt=doubts[0], beyond=doubts[1]))
        assert np.allclose(kept.last.residual_mm, 2.0)


def test_what_the_source_felt_and_the_rest_are_doubted_apart_and_contact_less_beyond():
    kept = held_back(found(2.0, 2.0), LEFT, 1.0, Trust(felt=0.0, beyond=3.0))
    assert np.allclose(kept.last.residual_mm[:, 0], 2.0, atol=5e-3)
    assert np.allclose(kept.last.residual_mm[:, -1], 0.2, atol=5e-3)
    assert np.allclose(kept.last.contact[:, 0], 1.0, atol=5e-3)
    assert np.allclose(kept.last.contact[:, -1], np.sqrt(0.1), atol=5e-3)
    surer = held_back(found(2.0, 2.0), LEFT, 1.0, Trust(felt=3.0, beyond=3.0))
    assert np.allclose(surer.last.contact[:, 0], 0.1, atol=5e-3)
    assert np.array_equal(kept.states[0].residual_mm, kept.last.residual_mm)


def test_by_a_power_little_told_is_nothing_and_much_is_more():
    squared = Trust(felt=1.0, beyond=1.0, power=2.0, unit_mm=3.0)
    for told, off in ((0.3, 0.03), (3.0, 3.0), (6.0, 12.0)):
        assert np.allclose(squared.off_mm(np.full(SHAPE, np.float32(told)), LEFT), off, rtol=1e-5)
    plain = Trust(felt=1.0, beyond=1.0)
    little, much = ((found(2.0, told), LEFT, 1.0) for told in (0.3, 6.0))
    assert held_back(*little, squared).last.residual_mm.mean() > held_back(*little, plain).last.residual_mm.mean()
    assert held_back(*much, squared).last.residual_mm.mean() < held_back(*much, plain).last.residual_mm.mean()


def test_weights_that_tell_no_power_are_believed_in_proportion():
    net = ResidualDenoiser(inputs=3, unit_mm=3.0, first=4, levels=2, doubt=1.5, doubt_beyond=2.5)
    assert trust(net) == Trust(felt=1.5, beyond=2.5, power=1.0, unit_mm=3.0)


def test_where_the_source_felt_contact_may_stay_that_of_physics():
    kept = held_back(found(2.0, 0.01), LEFT, 1.0, Trust(felt=1.0, beyond=1.0), contact=False)
    assert not kept.last.contact[:, 0].any()
    assert np.allclose(kept.last.contact[:, -1], 1.0, atol=1e-3)
    bold = held_back(found(2.0, 0.01), LEFT, 0.0, Trust(felt=1.0, beyond=1.0), contact=False)
    assert (bold.last.contact == 1.0).all(), "without caution all that the network says"


def test_a_touch_told_against_another_first_answer_is_the_same_touch():
    rest = at_rest(sensor("soft_bubble")).membrane
    shape = rest.indentation_mm.shape
    state = State(sigma=0.0, residual_mm=np.full(shape, np.float32(2.0)), contact=np.ones(shape, np.float32))
    one = Sampled(last=state, spread_mm=np.ones(shape, np.float32), passes=1, states=(state,), notes=())
    deeper = type(rest)(
        indentation_mm=np.full(shape, np.float32(0.5)), depth_mm=rest.depth_mm, contact=np.ones(shape, bool),
        camera=rest.camera, source_index=rest.source_index,
    )  # fmt: skip
    told = against(one, deeper)
    assert np.allclose(told.last.residual_mm, 1.5)
    assert not told.last.contact.any()
    assert np.allclose(told.states[0].residual_mm, 1.5)
