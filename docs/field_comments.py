"""For the API pages: a field's comment at the end of its line is its description."""

from typing import Any

import griffe


class FieldComments(griffe.Extension):
    """Takes the comment of a field without a docstring as its docstring."""

    def on_attribute(self, *, attr: griffe.Attribute, **_kwargs: Any) -> None:
        """Describe one field, or a name of a module."""
        comment = (
            attr.source.partition("  # ")[2].strip()
            if attr.docstring is None and attr.lineno
            else ""
        )
        if comment:
            attr.docstring = griffe.Docstring(comment[0].upper() + comment[1:], parent=attr)
