from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import SettingProblem
from pipeline.core.params import NoParams, list_settings, replace_value, setting
from pipeline.stages.depth.depth_anything import DepthAnythingParams
from pipeline.stages.touch.residual_diffusion import DiffusionParams

Mode = Literal["bake", "grill"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Oven:
    heat_deg: float = setting(180.0, "Heat", unit="°C", low=50.0, high=250.0)
    trays: int = setting(2, "Trays", low=1, high=4)
    fan: bool = setting(True, "Fan")
    mode: Mode = setting("bake", "Mode", choices=Mode)


def test_settings_come_in_order_with_their_values():
    assert list(list_settings(Oven())) == ["heat_deg", "trays", "fan", "mode"]
    value, setting = list_settings(Oven())["heat_deg"]
    assert (value, setting.unit, setting.high) == (180.0, "°C", 250.0)


@given(st.floats(50.0, 250.0))
def test_a_number_written_as_text_is_read_exactly(heat):
    assert replace_value(Oven(), "heat_deg", repr(heat)).heat_deg == heat


@pytest.mark.parametrize(
    ("text", "value"), [("true", True), ("off", False), ("1", True), ("No", False)]
)
def test_switches_take_the_usual_words(text, value):
    assert replace_value(Oven(), "fan", text).fan is value


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("heat", "3", "no parameter 'heat'; there are heat_deg, trays, fan, mode"),
        ("heat_deg", "warm", "heat_deg must be a number, got 'warm'"),
        ("heat_deg", "180,5", "heat_deg must be a number, got '180,5'; use a decimal point: 180.5"),
        ("heat_deg", "20", "heat_deg must lie within 50 and 250 °C, got 20"),
        ("heat_deg", "nan", "heat_deg must lie within 50 and 250 °C, got nan"),
        ("trays", 2.5, "trays must be a whole number, got 2.5"),
        ("fan", "perhaps", "fan must be on or off, got 'perhaps'"),
        ("mode", "fry", "mode must be one of bake, grill, got 'fry'"),
    ],
)
def test_a_wrong_setting_is_named_with_what_is_allowed(name, value, sentence):
    with pytest.raises(SettingProblem) as caught:
        replace_value(Oven(), name, value)
    assert str(caught.value) == sentence


def test_a_method_without_parameters_says_so():
    with pytest.raises(SettingProblem, match="no parameter 'heat'; there are none here"):
        replace_value(NoParams(), "heat", "3")


@pytest.mark.parametrize(
    "params", [DepthAnythingParams(), DiffusionParams()], ids=lambda p: type(p).__name__
)
def test_words_that_may_be_chosen_are_those_of_the_type(params):
    hints = get_type_hints(type(params))
    words = {
        name: setting.choices
        for name, (value, setting) in list_settings(params).items()
        if isinstance(value, str)
    }
    assert words
    assert words == {name: get_args(hints[name]) for name in words}
