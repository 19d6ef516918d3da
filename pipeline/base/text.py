"""Make foreign text safe to show: control characters in names and attributes are escaped."""

import re
import unicodedata

MOST_LETTERS = 500  # of a sentence; a file may hold texts of any length


def escape_text(text: str) -> str:
    r"""Return `text` on one line: control and direction marks and undecodable bytes become escapes such as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else _escape_character(c) for c in text)


def shorten_text(text: str, most: int = MOST_LETTERS) -> str:
    """Return the start and the end of a text with more than `most` letters."""
    return text if len(text) <= most else f"{text[: most * 2 // 3]}…{text[-(most // 3) :]}"


def hint_decimal_comma(text: str) -> str:
    """Return a hint with the first decimal comma of `text` as a point, to end a sentence; empty without a comma."""
    found = re.search(r"-?\d*,\d+", text)
    return f"; use a decimal point: {found[0].replace(',', '.')}" if found else ""


def is_utf8_encodable(name: str) -> bool:
    """Return whether a file name is valid UTF-8, as some libraries require."""
    return not any("\ud800" <= c <= "\udfff" for c in name)


def _escape_character(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
