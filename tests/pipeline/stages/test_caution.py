"""What is taken of a correction: all that is sure, nothing where physics is as good, and no edge of its own."""

import numpy as np
import pytest

from pipeline.sensors.spec import sensor
from pipeline.stages.generate.caution import against, held_back, taken
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
        kept = held_back(found(2.0, 1.0), LEFT, caution, doubts)
        assert np.allclose(kept.last.residual_mm, 2.0)


def test_what_the_source_felt_and_the_rest_are_doubted_apart_and_contact_where_it_felt_alone():
    kept = held_back(found(2.0, 2.0), LEFT, 1.0, (0.0, 3.0))
    assert np.allclose(kept.last.residual_mm[:, 0], 2.0, atol=5e-3)
    assert np.allclose(kept.last.residual_mm[:, -1], 0.2, atol=5e-3)
    assert np.allclose(kept.last.contact[:, 0], 1.0, atol=5e-3)
    assert (kept.last.contact[:, -1] == 1.0).all()
    surer = held_back(found(2.0, 2.0), LEFT, 1.0, (3.0, 3.0))
    assert np.allclose(surer.last.contact[:, 0], 0.1, atol=5e-3)
    assert np.array_equal(kept.states[0].residual_mm, kept.last.residual_mm)


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
