"""Defer imports that libraries make but rarely use."""

import importlib.util
import sys


def defer_import(*names: str) -> None:
    """Load submodules of loaded packages at their first attribute access; modules already loaded are unchanged."""
    for name in names:
        package, _, last = name.rpartition(".")
        spec = None if name in sys.modules or package not in sys.modules else importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            continue
        spec.loader = importlib.util.LazyLoader(spec.loader)
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        setattr(sys.modules[package], last, module)
