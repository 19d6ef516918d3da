"""Scale of force from weighings: what they determine, and its place in a calibration file."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.calibration import calibration_file
from pipeline.calibration.calibration_table import make_built_in
from pipeline.calibration.force_scale import fit_force_scale, load_force_scale, save_force_scale
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.sensors.spec import load_sensor

FORCES = st.floats(0.05, 50.0)


@given(st.floats(0.1, 10.0), FORCES, FORCES, FORCES)
def test_proportional_weighings_give_their_factor_at_every_force(factor, first, second, other):
    scale = fit_force_scale("gelslim", [first, second], [factor * first, factor * second])
    assert scale.exponent == pytest.approx(1.0)
    assert scale.apply(other) == pytest.approx(factor * other)
    assert scale.apply(0.0) == 0.0


def test_an_exponent_is_followed_only_where_the_forces_are_far_apart():
    close = fit_force_scale("gelslim", [1.0, 1.1], [1.0, 1.1**1.5])
    far = fit_force_scale("gelslim", [0.2, 10.0], [0.2**1.5, 10.0**1.5])
    assert close.exponent < 1.05
    assert far.exponent == pytest.approx(1.5, abs=0.05)
    assert any("too similar" in text for text in close.warnings)
    assert far.warnings == ()


def test_a_weighing_that_contradicts_the_others_is_named():
    scale = fit_force_scale("digit", [1.0, 2.0, 4.0], [1.0, 2.0, 12.0])
    assert any("weighing" in text and "%" in text for text in scale.warnings)


@pytest.mark.parametrize(
    ("estimated", "weighed", "part"),
    [
        ([1.0], [1.0], "two weighings"),
        ([1.0, 2.0], [1.0, -2.0], "above 0 N"),
        ([0.0, 1.0], [1.0, 2.0], "no contact"),
    ],
)
def test_unusable_weighings_are_refused(estimated, weighed, part):
    with pytest.raises(SettingProblem, match=part):
        fit_force_scale("digit", estimated, weighed)


def test_a_scale_shares_the_file_of_a_table_or_stands_alone(tmp_path):
    scale = fit_force_scale("gelsight_mini", [1.0, 3.0], [2.0, 7.0])
    table, both, alone = (tmp_path / f"{name}.npz" for name in ("table", "both", "alone"))
    calibration_file.save(make_built_in(load_sensor("gelsight_mini")), table)
    save_force_scale(scale, both, table)
    save_force_scale(scale, alone)
    assert load_force_scale(table) is None
    for path in (both, alone):
        read = load_force_scale(path)
        assert read is not None
        assert (read.sensor, read.factor, read.exponent) == (
            scale.sensor,
            scale.factor,
            scale.exponent,
        )
        assert calibration_file.is_calibration_file(path)
    assert calibration_file.load_if_present(alone) is None
    kept = calibration_file.load_if_present(both)
    assert kept is not None
    assert np.array_equal(kept.model.coefficients, calibration_file.load(table).model.coefficients)


@pytest.mark.parametrize(
    ("damage", "part"),
    [
        ({"force_scale": [-1.0, 1.0]}, "force_scale"),
        ({"force_scale": [np.nan, 1.0]}, "force_scale"),
        ({"force_weighings": np.zeros((2, 2))}, "force_weighings"),
        ({"force_weighings": np.ones((100_000, 2))}, "more than 100000 values"),
        ({"force_sensor": 3}, "force_sensor"),
    ],
)
def test_a_damaged_scale_names_file_and_field(tmp_path, damage, part):
    path = tmp_path / "bad.npz"
    whole = {"force_scale": [1.0, 1.0], "force_weighings": np.ones((2, 2)), "force_sensor": "digit"}
    np.savez(path, **{**whole, **damage})
    with pytest.raises(FileProblem, match=part) as refused:
        load_force_scale(path)
    assert "bad.npz" in str(refused.value)
