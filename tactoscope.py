"""The `tactoscope` command: sees to it that `app`, `widgets` and `pipeline` are this project's before they are run.

The three names are common ones, and another program's folder of that name may come first where Python looks.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

PACKAGES = ("app", "widgets", "pipeline")


def main() -> None:
    """Entry of the `tactoscope` script; ends with 2 and one sentence where another package stands in the way."""
    here = Path(__file__).resolve().parent
    for name in PACKAGES:
        found = _place(importlib.util.find_spec(name))
        if found != here / name:
            sys.stderr.write(
                f"tactoscope: another package named {name!r} comes before this project's; take it out of PYTHONPATH, "
                f"or give Tactoscope an environment of its own: '{found}'\n"
            )
            sys.exit(2)
    from app.command import main as run

    run()


def _place(spec: ModuleSpec | None) -> Path | None:
    """The folder of a package, or the file of a module."""
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).resolve()
    return None if spec.origin is None else Path(spec.origin).resolve()
