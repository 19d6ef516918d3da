"""Read a file's tables into declared types: what is missing, of another type or out of range is one sentence.

The types are dataclasses and `msgspec.Struct`s; the annotations below limit what a stranger's file may say.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from pipeline.base.errors import FileProblem

T = TypeVar("T")
NO_NUL = r"^[^\x00]*$"  # which no path may hold
Name = Annotated[str, Meta(max_length=1000, pattern=NO_NUL)]
FileName = Annotated[str, Meta(max_length=4096, pattern=NO_NUL)]
Note = Annotated[str, Meta(max_length=10_000)]
Number = Annotated[float, Meta(ge=-1e12, le=1e12)]  # finite
Plain = bool | int | Number | Note  # value of a parameter


def convert(data: object, kind: type[T], what: str, path: Path) -> T:
    """Return `data` of a file as `kind`; raises FileProblem that names the first wrong field."""
    try:
        return msgspec.convert(data, kind, str_keys=True)
    except UnicodeEncodeError as error:
        raise FileProblem(f"{what} cannot be used (it holds a text that is not Unicode)", path) from error
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `")
        missing = text.partition("missing required field `")[2]
        field = ".".join(filter(None, (place.lstrip("$.`").rstrip("`").removeprefix("key in "), missing.rstrip("`"))))
        said = "it is missing" if missing else text.replace("`", "").replace("Expected", "expected")
        where = f"{field}: " if field else ""
        top = field.partition(".")[0].partition("[")[0]
        raise FileProblem(f"{what} cannot be used ({where}{said})", path, field=top or None) from error


def to_plain(value: object) -> Any:
    """Return a dataclass or Struct as tables, lists, texts and numbers."""
    return msgspec.to_builtins(value, str_keys=True)
