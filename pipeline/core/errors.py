"""Errors that a user can solve, each one sentence (what, where and what to try), and notes on a
stage's result.

Foreign text in them is safe to show: control characters in names and attributes are escaped.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Container, Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

MOST_LETTERS = 500  # of a sentence; a file may hold texts of any length


def escape_text(text: str) -> str:
    r"""Return `text` on one line: control and direction marks and undecodable bytes become
    escapes such as `\x1b`.
    """
    if text.isprintable():
        return text
    return "".join(
        c
        if c.isprintable() or unicodedata.category(c) == "Zs"
        else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def shorten_text(text: str, most: int = MOST_LETTERS) -> str:
    """Return the start and the end of a text with more than `most` letters."""
    return text if len(text) <= most else f"{text[: most * 2 // 3]}…{text[-(most // 3) :]}"


def hint_decimal_comma(text: str) -> str:
    """Return a hint with the first decimal comma of `text` as a point, to end a sentence.

    Empty without a comma.
    """
    found = re.search(r"-?\d*,\d+", text)
    return f"; use a decimal point: {found[0].replace(',', '.')}" if found else ""


_OPTION = re.compile(r" \((?:[a-z_]+=, )?--([a-z-]+)\)|(?<![\w-])--([a-z][a-z-]*)")
# option -> argument of another name in Python
_ARGUMENTS = {"sensor": "source", "method": "methods", "poses": "n", "tools": "shape"}


def name_options(sentence: str, arguments: Container[str] = ()) -> str:
    """Return a sentence that names options of the command line in words, for the window, or as the
    `arguments` of a function that has them.
    """

    def say(option: re.Match[str]) -> str:
        name = (option[1] or option[2]).replace("-", "_")
        name = name if name in arguments else _ARGUMENTS.get(name, name)
        if name in arguments:
            return f" ({name}=)" if option[1] else name
        words = (option[2] or "").replace("-", " ")
        return words and f"the {words}"

    return _OPTION.sub(say, sentence)


def is_utf8_encodable(name: str) -> bool:
    """Return whether a file name is valid UTF-8, as some libraries require."""
    return not any("\ud800" <= c <= "\udfff" for c in name)


class TouchError(Exception):
    """Root of all errors that a user can solve; the text is shown without a traceback.

    Control characters from files and names are escaped, so that it stays one sentence on any
    terminal; of a long text the start and the end are shown.
    """

    alternatives: tuple[Path, ...] = ()  # recordings of the same folder, one of which may be meant

    def __init__(self, text: str) -> None:
        """One sentence: what, where, what to try."""
        super().__init__(shorten_text(escape_text(text)))


class FileProblem(TouchError):
    """A file is missing, damaged, or not what it says; `path` names it."""

    def __init__(self, what: str, path: Path | str) -> None:
        """Build the sentence `what: 'path'`, with the path last so that it can be cut off."""
        self.path = Path(path)
        self._what = what
        super().__init__(f"{what}: '{path}'")

    def relocate(self, place: Path, instead_of: Path) -> FileProblem:
        """Return the error with its path under `instead_of` moved to `place`.

        Unchanged for a file elsewhere.
        """
        if not self.path.is_relative_to(instead_of):
            return self
        return FileProblem(self._what, place / self.path.relative_to(instead_of))

    def extend(self, hint: str) -> FileProblem:
        """Return the error with a hint after its sentence, before the path."""
        return FileProblem(f"{self._what}{hint}", self.path)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the error for worker processes."""
        return FileProblem, (self._what, self.path)


class ShapeError(TouchError):
    """An array has another shape, type or content than the stage needs."""


class MissingReference(ShapeError):
    """A frame comes without an image of its sensor without contact."""


class SensorMismatch(ShapeError):
    """The images of a frame have another size than those of the stated sensor."""


class CalibrationError(TouchError):
    """A sensor description, look-up, intrinsic matrix or alignment cannot be used."""


@contextmanager
def naming_file(path: Path) -> Generator[None]:
    """Name the file in the sentence of a CalibrationError of the block."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{path}'") from error


class SettingProblem(TouchError):
    """A parameter, sensor, route or option does not exist or is out of its range."""


class UnknownSensor(SettingProblem):
    """A recording does not say which sensor made it, and the user has not said so either."""


class MeshProblem(TouchError):
    """An object mesh is empty, damaged, or in a unit that cannot be right."""


class ModelMissing(TouchError):
    """Weights of a network are missing or belong to another network.

    A method without them is used instead.
    """


class NotConverged(TouchError):
    """An iterative solver ended without a reliable result."""


class StageWarning(str):
    """A note that the result may be wrong; shown, counted and reported apart from plain notes.

    It is a string, so that it goes wherever notes go.
    """


class AlignmentWarning(StageWarning):
    """A warning that the touch misses the target: another alignment mends it."""


class CalibrationWarning(StageWarning):
    """A warning that sizes and depths are unsure: a calibration of the source sensor mends it."""


class UnseenObjectWarning(StageWarning):
    """A warning that the target touches more of the object than the source measured: the touch
    may be wrong by mm.
    """


class OutsideViewWarning(UnseenObjectWarning):
    """A warning that a method leaves out what lies outside the source's view: one that generates
    it is better.
    """


class UncertainContact(StageWarning):
    """A warning that a frame without a measured contact may have one: neither "no contact" nor
    "exact".
    """


class ChangeNote(str):
    """A note of how far a network's result is from physics; the window shows it as a badge."""


UNCERTAIN_CONTACT = UncertainContact(
    "contact uncertain: the image has changed; a light, large touch would look the same: add an "
    "untouched frame as the "
    "reference"
)
AT_BORDER = StageWarning("the contact reaches the image border: the part beyond is missing")


def find_uncertain_contact(notes: Iterable[str]) -> UncertainContact | None:
    """The note that no contact was measured where there may be one; None without it."""
    return next((note for note in notes if isinstance(note, UncertainContact)), None)


def describe_no_contact(result: str, notes: Iterable[str], certainty: str = "") -> str:
    """Return the note of a value without contact, uncertain where one of the `notes` of what it is
    made of is.

    `result` says what the value is, `certainty` what holds of it only where there is certainly no
    contact.
    """
    if find_uncertain_contact(notes) is not None:
        return UncertainContact(f"contact uncertain: {result}")
    return f"no contact: {result}{certainty}"


def select_warnings(notes: Iterable[str]) -> tuple[StageWarning, ...]:
    """Return the warnings among the notes, in order."""
    return tuple(note for note in notes if isinstance(note, StageWarning))
