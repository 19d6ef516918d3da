"""Stage parameters: frozen dataclasses whose fields carry what a person needs to set them.

The command line's `--set stage.field=value` and the app's labelled controls are both derived from here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar, cast, get_args

from pipeline.base.errors import SettingProblem
from pipeline.base.text import hint_decimal_comma

P = TypeVar("P")
Value = bool | int | float | str

_KINDS: dict[type, str] = {bool: "on or off", int: "a whole number", float: "a number", str: "a text"}
_YES, _NO = {"true", "on", "yes", "1"}, {"false", "off", "no", "0"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """How one parameter is shown and what it may be."""

    label: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    step: float = 0.0  # of a spin box; 0 = a tenth of the range
    choices: tuple[str, ...] = ()
    help: str = ""
    source: str = ""  # where the equation comes from that it stands in
    sensor_kind: str = ""  # the kind of sensor that it says anything of, "" = any

    def applies_to(self, kind: str) -> bool:
        """Whether it says anything of a sensor of that kind; "" is one that is not known."""
        return not (self.sensor_kind and kind) or self.sensor_kind == kind


def is_draft(params: object) -> bool:
    """Whether these are cheaper than what was asked for, so that their answer is to be called a draft."""
    return bool(getattr(params, "draft", False))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoParams:
    """Of a method that has nothing to set."""


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
) -> Any:
    """A dataclass field with a default and its `Setting`; `choices` is the `Literal` that the field is declared as."""
    words = get_args(choices) or tuple(choices)
    told = Setting(
        label=label, unit=unit, low=low, high=high, step=step, choices=words, help=help, source=source, sensor_kind=only
    )  # fmt: skip
    return field(default=default, metadata={"setting": told})


def list_settings(params: object) -> Mapping[str, tuple[Value, Setting]]:
    """Name -> (value, how to show it) of every parameter, in the order of definition."""
    return {
        f.name: (getattr(params, f.name), f.metadata["setting"])
        for f in fields(cast("Any", params))
        if "setting" in f.metadata
    }


def replace_value(params: P, name: str, value: Value) -> P:
    """`params` with one value replaced, after checking its type and range; raises SettingProblem."""
    known = list_settings(params)
    if name not in known:
        raise SettingProblem(f"no parameter {name!r}; there are {', '.join(known)}")
    old, told = known[name]
    try:
        new = _converted(value, type(old))
    except ValueError:
        raise SettingProblem(
            f"{name} must be {_KINDS[type(old)]}, got {value!r}{hint_decimal_comma(str(value))}"
        ) from None
    if told.choices and new not in told.choices:
        raise SettingProblem(f"{name} must be one of {', '.join(told.choices)}, got {value!r}")
    if isinstance(new, (int, float)) and not isinstance(new, bool) and not told.low <= new <= told.high:
        unit = f" {told.unit}" if told.unit else ""
        raise SettingProblem(f"{name} must lie within {told.low:g} and {told.high:g}{unit}, got {new:g}")
    return cast("P", replace(cast("Any", params), **{name: new}))


def _converted(value: Value, kind: type) -> Value:
    if kind is bool:
        word = str(value).lower()
        if word not in _YES | _NO:
            raise ValueError(value)
        return word in _YES
    if kind is int and isinstance(value, float) and not value.is_integer():
        raise ValueError(value)
    return cast("Value", kind(value))
