"""The `tactoscope` command: checks that `app`, `widgets` and `pipeline` are this project's packages, then runs it.

The three names are common, and another package of the same name may come first on the import path.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

PACKAGES = ("app", "widgets", "pipeline")


def main() -> None:
    """Entry point of the script; exits with 2 and a message if another package shadows one of this project's."""
    here = Path(__file__).resolve().parent
    for name in PACKAGES:
        found = _find_location(importlib.util.find_spec(name))
        if found != here / name:
            sys.stderr.write(
                f"tactoscope: another package named {name!r} shadows this project's; remove it from PYTHONPATH, or "
                f"install Tactoscope in its own environment: '{found}'\n"
            )
            sys.exit(2)
    from app.command import main as run

    run()


def _find_location(spec: ModuleSpec | None) -> Path | None:
    """Return the folder of a package, or the file of a module."""
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).resolve()
    return None if spec.origin is None else Path(spec.origin).resolve()


if __name__ == "__main__":
    main()
