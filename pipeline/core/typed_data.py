"""Read a file's tables into declared types: what is missing, of another type or out of range is one
sentence.

The types are dataclasses and `msgspec.Struct`s; the annotations below limit what a stranger's file
may say.
"""

import re
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from pipeline.core.errors import FileProblem, shorten_text

T = TypeVar("T")
NO_NUL = r"^[^\x00]*$"  # which no path may hold
Name = Annotated[str, Meta(max_length=1000, pattern=NO_NUL)]
FileName = Annotated[str, Meta(max_length=4096, pattern=NO_NUL)]
Note = Annotated[str, Meta(max_length=10_000)]
Number = Annotated[float, Meta(ge=-1e12, le=1e12)]  # finite
Plain = bool | Annotated[int, Meta(ge=-(2**53), le=2**53)] | Number | Note  # value of a parameter
_MOST_LETTERS = 120  # of a wrong value or key in a sentence
_WORDS = {
    "object": "a table",
    "array": "a list",
    "str": "a text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "null": "nothing",
}


class InvalidField(ValueError):
    """A value is missing, of another type or out of range.

    `field` names its place, "" = the whole.
    """

    def __init__(self, field: str, problem: str) -> None:
        """Build the clause `field: problem`."""
        self.field = field
        where = shorten_text(field, _MOST_LETTERS)
        what = shorten_text(problem, _MOST_LETTERS)
        super().__init__(f"{where}: {what}" if field else what)


def check(data: object, kind: type[T], within: str = "") -> T:
    """Return `data` as `kind`; raises InvalidField for the first wrong value. `within` names the
    table it is in.
    """
    try:
        return msgspec.convert(data, kind, str_keys=True)
    except UnicodeEncodeError as error:
        raise InvalidField(within, "it holds a text that is not Unicode") from error
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `")
        missing = text.partition("missing required field `")[2]
        inner = place.rstrip("`").removeprefix("key` in `").removeprefix("$").removeprefix(".")
        field = ".".join(filter(None, (within, inner, missing.rstrip("`")))).replace(".[", "[")
        raise InvalidField(field, "it is missing" if missing else _describe(text)) from error


def convert(
    data: object, kind: type[T], what: str, path: Path, *, remedy: str = "", within: str = ""
) -> T:
    """Return `data` of a file as `kind`.

    Raises FileProblem that names the first wrong field, and the remedy.

    `within` names the table of the file that `data` is, "" = the whole file.
    """
    try:
        return check(data, kind, within)
    except InvalidField as error:
        advice = f"; {remedy}" if remedy else ""
        raise FileProblem(f"{what} cannot be used ({error}){advice}", path) from error


def _describe(text: str) -> str:
    """Return what msgspec says of a wrong value in words.

    "Expected `int`" becomes "expected a whole number".
    """

    def name(found: re.Match[str]) -> str:
        return " or ".join(_WORDS.get(kind, kind) for kind in found[1].split(" | "))

    return re.sub("`([^`]*)`", name, text).replace("Expected", "expected")


def to_plain(value: object) -> Any:
    """Return a dataclass or Struct as tables, lists, texts and numbers."""
    return msgspec.to_builtins(value, str_keys=True)
