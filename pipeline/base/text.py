"""Text that comes from outside, made safe to show: no file name or attribute moves a cursor or hides a word."""

from __future__ import annotations

import re
import unicodedata


def escape_text(text: str) -> str:
    r"""`text` on one line: control and direction marks, and bytes that are no text, as escapes such as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else _escaped(c) for c in text)


def hint_decimal_comma(text: str) -> str:
    """What to write where the first decimal comma of `text` stands, as the end of a sentence; empty where none does."""
    found = re.search(r"-?\d*,\d+", text)
    return f"; decimals stand behind a point: {found[0].replace(',', '.')}" if found else ""


def is_utf8_encodable(name: str) -> bool:
    """Whether a file's name can be given to a library that takes nothing but UTF-8."""
    return not any("\ud800" <= c <= "\udfff" for c in name)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
