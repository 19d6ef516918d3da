"""For the API pages: the comment at the end of a field's line, or above it, is its description."""

from itertools import takewhile
from pathlib import Path
from typing import Any

import griffe


class FieldComments(griffe.Extension):
    """Takes the comment of a field without a docstring as its docstring, and knows that `frozen`
    makes a dataclass.
    """

    def on_class_members(self, *, cls: griffe.Class, **_kwargs: Any) -> None:
        """Let the arguments of a value be listed."""
        for decorator in cls.decorators:
            if decorator.callable_path == "pipeline.core.frozen.frozen":
                dataclass = griffe.ExprName("dataclass", parent="dataclasses")
                by_name = griffe.ExprKeyword("kw_only", "True", function=dataclass)
                decorator.value = griffe.ExprCall(dataclass, [by_name])

    def on_attribute(self, *, attr: griffe.Attribute, **_kwargs: Any) -> None:
        """Describe one field, or a name of a module."""
        if attr.docstring is not None or not attr.lineno:
            return
        comment = attr.source.partition("  # ")[2].strip() or _read_above(attr)
        if comment:
            attr.docstring = griffe.Docstring(comment[0].upper() + comment[1:], parent=attr)


def _read_above(attr: griffe.Attribute) -> str:
    """The comment that fills the lines above a field."""
    assert isinstance(attr.filepath, Path)
    before = attr.filepath.read_text(encoding="utf-8").splitlines()[: (attr.lineno or 1) - 1]
    above = takewhile(lambda line: line.startswith("# "), (line.strip() for line in before[::-1]))
    return " ".join(line.removeprefix("# ") for line in reversed(list(above)))
