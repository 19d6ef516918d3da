"""Modules that others name but nobody uses: they are there at once, and loaded when something of them is asked for."""

from __future__ import annotations

import importlib.util
import sys


def defer_import(*names: str) -> None:
    """Have submodules of loaded packages loaded by the first look into them; those loaded already stay as they are."""
    for name in names:
        package, _, last = name.rpartition(".")
        spec = None if name in sys.modules or package not in sys.modules else importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            continue
        spec.loader = importlib.util.LazyLoader(spec.loader)
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        setattr(sys.modules[package], last, module)
