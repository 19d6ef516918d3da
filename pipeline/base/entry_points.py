"""Values that other installed packages add to this program through Python entry points."""

import importlib
import importlib.metadata
import logging
from functools import cache
from typing import Any

log = logging.getLogger("tactoscope")


@cache
def load_entry_points(group: str) -> tuple[Any, ...]:
    """The values of an entry point group such as `tactoscope.formats`, sorted by name and loaded once.

    An entry point that cannot be loaded is left out with a warning in the log.
    """
    values: list[Any] = []
    for entry in sorted(importlib.metadata.entry_points(group=group), key=lambda e: e.name):
        try:
            values.append(entry.load())
        except Exception as error:  # noqa: BLE001 - a border: another package's code may raise anything
            log.warning("%s: the entry point %s = %s cannot be loaded (%s)", group, entry.name, entry.value, error)
    return tuple(values)


@cache
def load_reference(reference: str) -> Any:
    """The object that "package.module:name" names; its module is imported on first use."""
    module, name = reference.split(":")
    return getattr(importlib.import_module(module), name)
