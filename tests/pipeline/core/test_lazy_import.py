"""Modules that are there before they are loaded."""

from __future__ import annotations

import importlib
import sys

from pipeline.core.arrays import defer_import


def test_a_module_is_loaded_by_the_first_look_into_it(tmp_path, monkeypatch):
    (tmp_path / "whole_package").mkdir()
    (tmp_path / "whole_package/__init__.py").touch()
    (tmp_path / "whole_package/part.py").write_text(
        "import sys\nsys.modules[__package__].loaded = True\nvalue = 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    package = importlib.import_module("whole_package")
    defer_import("whole_package.part", "whole_package.absent", "no_such_package.part")
    assert sys.modules["whole_package.part"] is package.part
    assert not hasattr(package, "loaded")
    assert package.part.value == 3
    assert package.loaded
    defer_import("whole_package.part")
    assert package.part.value == 3
    for name in ("whole_package.part", "whole_package"):
        del sys.modules[name]
