"""Values that other installed packages add to this program through Python entry points.

A package can break nothing but itself: what cannot be loaded, or is not of the declared types, is
left out with a warning in the log.
"""

import importlib
import importlib.metadata
import logging
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from pipeline.core.errors import TouchError, escape_text, shorten_text

log = logging.getLogger("tactoscope")
T = TypeVar("T")
# what another package's code may raise; Ctrl-C is the user's
FOREIGN_ERRORS = (Exception, SystemExit)


@cache
def load_entry_points(
    group: str, kind: type[T], check: Callable[[T], object] = bool
) -> tuple[T, ...]:
    """The values of an entry point group such as `tactoscope.formats`, sorted by name and loaded
    once.

    A value is of `kind`, its fields are of the types that `kind` declares, and `check` raises
    nothing for it.
    """
    values: list[T] = []
    for entry in _list_entries(group):
        try:
            value = entry.load()
            _require_types(value, kind)
            check(value)
        except FOREIGN_ERRORS as error:  # a border: another package's code may raise anything
            warn_of_package(f"{group}: the entry point {entry.name} = {entry.value}", error)
        else:
            values.append(value)
    return tuple(values)


def call_package(function: Callable[[], T], default: T, what: str) -> T:
    """What a function of another package returns, `default` with a warning in the log where it
    fails.

    A TouchError is passed on: it says what is wrong with the user's file.
    """
    try:
        return function()
    except TouchError:
        raise
    except FOREIGN_ERRORS as error:
        warn_of_package(what, error)
        return default


def warn_of_package(what: str, error: BaseException) -> None:
    """Log one line that something of another package is left out."""
    try:
        why = f"{type(error).__name__}: {error}"
    except FOREIGN_ERRORS:  # of the error's own text
        why = type(error).__name__
    log.warning("%s", escape_text(shorten_text(f"{what} cannot be used ({why}); it is left out")))


def _list_entries(group: str) -> list[importlib.metadata.EntryPoint]:
    try:
        return sorted(importlib.metadata.entry_points(group=group), key=lambda entry: entry.name)
    except FOREIGN_ERRORS as error:  # the list of a damaged installation
        warn_of_package(f"{group}: the list of installed packages", error)
        return []


def _require_types(value: object, kind: type) -> None:
    """Raise TypeError where a value, or a field of a dataclass, has another type than it
    declares.
    """
    if not isinstance(value, kind):
        raise TypeError(f"it is a {type(value).__name__}, not a {kind.__name__}")
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        for field in fields(kind):
            if not _has_type(getattr(value, field.name), hints[field.name]):
                raise TypeError(f"{field.name} is {getattr(value, field.name)!r:.80}")


def _has_type(value: Any, hint: Any) -> bool:
    """Whether a value has a declared type, as far as a table of values can be checked without
    calling anything.
    """
    origin = get_origin(hint) or hint
    inner = get_args(hint)
    if origin in (Union, UnionType):
        return any(_has_type(value, one) for one in inner)
    if origin is Literal:
        return value in inner
    if origin is tuple:
        return isinstance(value, tuple) and all(
            _has_type(one, inner[0]) for one in cast("tuple[Any, ...]", value)
        )
    if origin in (int, float):
        return isinstance(value, (int, origin)) and not isinstance(value, bool)
    if origin in (str, bytes, bool, type, type(None), Mapping):
        return isinstance(value, origin)
    return callable(value)


def load_reference(reference: str) -> Any:
    """The object that "package.module:name" names; its module is imported on first use."""
    module, name = reference.split(":")
    return getattr(importlib.import_module(module), name)
