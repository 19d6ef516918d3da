"""Damaged and malicious files: values, tables and bytes as a stranger may have left them."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np

JUNK: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    7,
    10**12,
    10**30,
    1e308,
    float("inf"),
    float("nan"),
    "",
    "x" * 100_000,
    "a\0b",
    "\ud800",
    "\x1b[2J",
    "../" * 40,
    "<img src=/dev/zero>",
    "[bold red]",
    [],
    {},
    [[]],
    [None],
    {"": ""},
    [1, 2, 3],
    {"a": {"a": []}},
    [{}] * 50,
)


def spoil_value(value: Any, rng: np.random.Generator) -> Any:
    """A copy of nested tables and lists with one entry replaced, removed, or added."""
    spoilt = copy.deepcopy(value)
    places = [(parent, key) for parent, key in _walk(spoilt)]
    parent, key = places[int(rng.integers(len(places)))]
    junk = copy.deepcopy(JUNK[int(rng.integers(len(JUNK)))])
    match int(rng.integers(6)):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[str(junk)[:50]] = parent[key]
        case _:
            parent[key] = junk
    return spoilt


def _walk(value: Any):
    pairs = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, inner in list(pairs):
        yield value, key
        yield from _walk(inner)


def spoil_bytes(content: bytes, rng: np.random.Generator, head: int = 1 << 30) -> bytes:
    """The bytes cut, zeroed, changed or repeated somewhere in their first `head`."""
    spoilt = bytearray(content)
    n = min(len(content), head)
    at = int(rng.integers(n))
    match int(rng.integers(5)):
        case 0:
            return bytes(spoilt[:at])
        case 1:
            spoilt[at : at + 64] = bytes(min(64, len(spoilt) - at))
        case 2:
            spoilt[at:at] = spoilt[max(0, at - 40) : at]
        case 3:
            spoilt[at : at + 4] = rng.choice(
                [b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\xff\xff\xff\x7f"]
            )
        case _:
            for place in rng.integers(0, n, 4):
                spoilt[place] = int(rng.integers(256))
    return bytes(spoilt)


def to_toml(table: dict[str, Any]) -> str:
    """Nested tables as TOML, on as many lines as there are keys; what TOML lacks becomes a text."""
    return "".join(f"{json.dumps(str(key))} = {_to_toml(value)}\n" for key, value in table.items())


def _to_toml(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(
                f"{json.dumps(str(key))} = {_to_toml(inner)}" for key, inner in value.items()
            )
            + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(_to_toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    text = json.dumps(str(value), ensure_ascii=False)
    return text.replace("\ud800", "\\uFFFD").replace("\x7f", "\\u007f")
