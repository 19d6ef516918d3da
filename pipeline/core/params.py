"""Stage parameters: frozen dataclasses whose fields describe how they are set.

The command line's `--set stage.field=value` and the app's controls are derived from them.
"""

import math
from collections.abc import Mapping
from dataclasses import field, fields, replace
from typing import Any, Literal, TypeVar, cast, get_args

from pipeline.core.errors import SettingProblem, hint_decimal_comma
from pipeline.core.frozen import frozen

P = TypeVar("P")
Value = bool | int | float | str
MeshUnit = Literal["auto", "mm", "cm", "m", "in", "inch"]  # of a mesh file, which does not state it
UNIT_MM: Mapping[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4}

_KINDS: dict[type, str] = {
    bool: "on or off",
    int: "a whole number",
    float: "a number",
    str: "a text",
}
_YES = {"true", "on", "yes", "1"}
_NO = {"false", "off", "no", "0"}


@frozen
class Setting:
    """Label, limits and help of one parameter."""

    label: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    step: float = 0.0  # of a spin box; 0 = a tenth of the range
    choices: tuple[str, ...] = ()
    choice_titles: tuple[str, ...] = ()  # of these, as people read them
    help: str = ""
    source: str = ""  # of the equation that uses it
    sensor_kind: str = ""  # that the parameter applies to, "" = any
    pinned: str = ""  # short label of a parameter that stays in sight in the stage's column
    # values that a sweep starts with; () = multiples of the current value
    sweep: tuple[Value, ...] = ()

    def applies_to(self, kind: str) -> bool:
        """Return whether the parameter applies to a sensor of that kind; "" = unknown kind."""
        return not (self.sensor_kind and kind) or self.sensor_kind == kind


def is_draft(params: object) -> bool:
    """Return whether the parameters are those of a faster draft."""
    return bool(getattr(params, "draft", False))


@frozen
class NoParams:
    """Parameters of a method without settings."""


def setting(
    default: Value,
    label: str,
    *,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    step: float = 0.0,
    choices: Any = (),
    help: str = "",  # noqa: A002 - the word users know
    source: str = "",
    only: str = "",
    pinned: str = "",
    sweep: tuple[Value, ...] = (),
) -> Any:
    """Return a dataclass field with a default and its `Setting`.

    `choices` is the field's `Literal` type, or choice -> title.
    """
    words = get_args(choices) or tuple(choices)
    rule = Setting(
        label=label,
        unit=unit,
        low=low,
        high=high,
        step=step,
        choices=words,
        choice_titles=tuple(choices.values()) if isinstance(choices, Mapping) else words,
        help=help,
        source=source,
        sensor_kind=only,
        pinned=pinned,
        sweep=sweep,
    )
    return field(default=default, metadata={"setting": rule})


def list_settings(params: object) -> Mapping[str, tuple[Value, Setting]]:
    """Return name -> (value, setting) of every parameter, in the order of definition."""
    return {
        f.name: (getattr(params, f.name), f.metadata["setting"])
        for f in fields(cast("Any", params))
        if "setting" in f.metadata
    }


def replace_value(params: P, name: str, value: Value) -> P:
    """Return `params` with one value replaced, after checking its type and range.

    Raises SettingProblem.
    """
    known = list_settings(params)
    if name not in known:
        raise SettingProblem(f"no parameter {name!r}; there are {', '.join(known) or 'none here'}")
    old, rule = known[name]
    try:
        new = _convert(value, type(old))
    except ValueError:
        raise SettingProblem(
            f"{name} must be {_KINDS[type(old)]}, got {value!r}{hint_decimal_comma(str(value))}"
        ) from None
    if rule.choices and new not in rule.choices:
        raise SettingProblem(f"{name} must be one of {', '.join(rule.choices)}, got {value!r}")
    if isinstance(new, (int, float)) and not isinstance(new, bool):
        check_range(name, new, rule.low, rule.high, rule.unit)
    return cast("P", replace(cast("Any", params), **{name: new}))


def split_assignment(text: str, what: str) -> tuple[str, str]:
    """(name, value) of `name=value`; raises SettingProblem that says `what` is written so."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals):
        raise SettingProblem(f"{what}, got {text!r}")
    return name, value


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise SettingProblem for a value outside [low, high], and for NaN."""
    if not low <= value <= high:
        least, most, got = (
            str(one) if isinstance(one, int) else f"{one:g}" for one in (low, high, value)
        )
        raise SettingProblem(
            f"{name} must lie within {least} and {most}{f' {unit}' if unit else ''}, got {got}"
        )


def _convert(value: Value, kind: type) -> Value:
    if kind is bool:
        word = str(value).lower()
        if word not in _YES | _NO:
            raise ValueError(value)
        return word in _YES
    if kind is int and isinstance(value, float) and not value.is_integer():
        raise ValueError(value)
    return cast("Value", kind(value))
