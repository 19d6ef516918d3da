"""What the names of image files say: their order, their times, and which of several sensors they
are of.
"""

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Doubles, freeze

# a minus follows a separator; between digits it is one itself
_WHOLE = re.compile(r"((?:^-|(?<=[_\s=,;(@])-)?\d+)")
_DECIMAL = re.compile(r"((?:^-|(?<=[_\s=,;(@])-)?\d+(?:\.\d+)?)")
# whole digits of a Unix time -> of its unit in a second
_UNITS_PER_S = {10: 1, 13: 10**3, 16: 10**6, 19: 10**9}
_NANOSECOND_DIGITS = range(7, 10)  # of the longest number after whole seconds
_TIME_WORD = re.compile(r"(^|[\W_\d])(t|time|times|timestamp|stamp)[\W_]*$", re.IGNORECASE)
_DATE = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)[T_\s-]*(\d\d)[-:_.]?(\d\d)[-:_.]?(\d\d)(?:[-_.](\d+))?(?!\d)"
)
_SENSOR_WORDS = (  # words of one line tell the sensors of one hand or rig apart
    ("left", "right"),
    ("l", "r"),
    ("top", "bottom"),
    ("upper", "lower"),
    ("first", "second"),
    ("thumb", "index", "middle", "ring", "little", "pinky"),
    ("gelslim", "gelsight", "digit", "mini", "bubble", "duragel", "tac3d"),
)
_NUMBERED = re.compile(
    r"(?<![a-z])(?:cam|camera|finger|sensor|gripper|digit|gelsight|gelslim|mini|tactile)"
    r"[\W_]?(\d+)(?!\d)",
    re.IGNORECASE,
)
_MAX_SENSORS = 8


def sort_series(files: Sequence[Path]) -> list[Path]:
    """The files of one folder in the order of the numbers in their names, frame_2 before frame_10.

    A point is a decimal point where no name has two and no two names are then equal. Where that
    changes the order and the files were written in the order of whole numbers, these count.
    """
    whole = sorted(files, key=lambda file: natural_sort_key(file.stem))
    points = {file.stem.count(".") for file in files}
    keys = {file: natural_sort_key(file.stem, _DECIMAL) for file in files}
    if not {1} <= points <= {0, 1} or len(set(keys.values())) < len(files):
        return whole
    decimal = sorted(files, key=lambda file: keys[file])
    return whole if decimal != whole and _were_written_in_order(whole) else decimal


def natural_sort_key(name: str, number: re.Pattern[str] = _WHOLE) -> tuple[object, ...]:
    """Sort key that puts frame_2 before frame_10, and -1 before 0."""
    parts = number.split(name)  # text, number, text, ...
    return tuple(
        (0, Decimal(p), "") if k % 2 else (1, Decimal(0), p.lower())
        for k, p in enumerate(parts)
        if p
    )


def _were_written_in_order(files: Sequence[Path]) -> bool:
    try:
        times_ns = [file.stat().st_mtime_ns for file in files]
    except OSError:
        return False
    return all(a < b for a, b in pairwise(times_ns))


def parse_times_s(files: Sequence[Path]) -> Doubles | None:
    """Times in seconds after the first file, as the names state them.

    None where they state none that only grow.

    Known are Unix times in s, ms, us or ns, whole seconds with nanoseconds after them, dates, and
    seconds after `t`.
    """
    return parse_series_times_s({"": files}).get("")


def parse_series_times_s(series: Mapping[str, Sequence[Path]]) -> Mapping[str, Doubles]:
    """As `parse_times_s` for the files of each sensor, after the first file of all.

    {} unless all series have times.
    """
    for parse in (_parse_unix_times, _parse_dates, _parse_seconds):
        found = {name: parse([file.stem for file in files]) for name, files in series.items()}
        if all(
            len(found[name]) == len(files) > 1 and all(a < b for a, b in pairwise(found[name]))
            for name, files in series.items()
        ):
            start = min(times[0] for times in found.values())
            return {
                name: freeze(np.array([float(t - start) for t in times]))
                for name, times in found.items()
            }
    return {}


def _parse_unix_times(stems: list[str]) -> list[Decimal]:
    numbers = [_DECIMAL.split(stem)[1::2] for stem in stems]
    for at in range(min(map(len, numbers), default=0)):
        column = [row[at] for row in numbers]
        digits = {len(text.partition(".")[0]) for text in column}
        unit = _UNITS_PER_S.get(digits.pop(), 0) if len(digits) == 1 else 0
        if not unit or len(set(column)) == 1 or any(text[0] not in "12" for text in column):
            continue
        after = [row[at + 1] if len(row) > at + 1 else "" for row in numbers]
        if (
            unit == 1
            and max(map(len, after)) in _NANOSECOND_DIGITS
            and all(text.isdecimal() for text in after)
        ):
            return [Decimal(s) + Decimal(ns) / 10**9 for s, ns in zip(column, after, strict=True)]
        if len(set(column)) == len(column):
            return [Decimal(text) / unit for text in column]
    return []


def _parse_dates(stems: list[str]) -> list[Decimal]:
    found = [match.groups() for match in map(_DATE.search, stems) if match]
    widths = {len(groups[6] or "") for groups in found}
    try:
        whole = [
            datetime.strptime("".join(groups[:6]), "%Y%m%d%H%M%S").replace(tzinfo=UTC)
            for groups in found
        ]
    except ValueError:
        return []
    # the date of the recording and a counter; digits that are not padded
    if len(set(whole)) < 2 or len(widths) > 1:
        return []
    return [
        Decimal(int(t.timestamp())) + Decimal(f"0.{groups[6] or 0}")
        for t, groups in zip(whole, found, strict=True)
    ]


def _parse_seconds(stems: list[str]) -> list[Decimal]:
    parts = [_DECIMAL.split(stem) for stem in stems]
    found = [
        row[k + 1] for row in parts for k in range(0, len(row) - 1, 2) if _TIME_WORD.search(row[k])
    ]
    return [Decimal(text) for text in found] if any("." in text for text in found) else []


def split_sensors(files: Sequence[Path]) -> Mapping[str, list[Path]]:
    """The files by the word or number in their names that tells sensors of one rig apart.

    {} where none does.
    """
    words = [set(re.findall(r"[a-z]+", file.stem.lower())) for file in files]
    for choices in _SENSOR_WORDS:
        named = [own.intersection(choices) for own in words]
        if all(len(name) == 1 for name in named) and len(set().union(*named)) > 1:
            return _group(files, [name.copy().pop() for name in named])
    matches = [
        _NUMBERED.findall(file.stem) if len(_WHOLE.findall(file.stem)) > 1 else [] for file in files
    ]
    if (
        all(len(found) == 1 for found in matches)
        and 1 < len({found[0] for found in matches}) <= _MAX_SENSORS
    ):
        return _group(
            files,
            [match[0].strip("_- ") for file in files if (match := _NUMBERED.search(file.stem))],
        )
    return {}


def _group(files: Sequence[Path], names: Sequence[str]) -> dict[str, list[Path]]:
    groups: dict[str, list[Path]] = {}
    for name, file in sorted(zip(names, files, strict=True), key=lambda item: item[0]):
        groups.setdefault(name, []).append(file)
    return groups


def select_common_numbers(groups: Mapping[str, Sequence[Path]]) -> dict[str, list[Path]]:
    """The files of each sensor whose other words and numbers all sensors have, so that frames of
    one number pair up.

    All files where less than half of them have: their numbers do not tell the moment.
    """
    keyed = {
        name: {_drop_word(file.stem, name): file for file in files}
        for name, files in groups.items()
    }
    common = set[str].intersection(*(set(files) for files in keyed.values()))
    if 2 * len(common) < max(len(files) for files in groups.values()):
        return {name: list(files) for name, files in groups.items()}
    return {
        name: [file for key, file in files.items() if key in common]
        for name, files in keyed.items()
    }


def _drop_word(stem: str, word: str) -> str:
    return re.sub(rf"(?<![a-z]){re.escape(word)}(?![a-z])", "", stem, count=1, flags=re.IGNORECASE)


def find_subseries(files: Sequence[Path]) -> Mapping[str, list[Path]]:
    """The files by all of their names but the number that counts frames.

    {} unless these are a few long series.
    """
    parts = [_DECIMAL.split(file.stem) for file in files]
    if len({len(row) for row in parts}) != 1 or len(parts[0]) < 2:
        return {}
    columns = list(zip(*parts, strict=True))
    counter = max(range(1, len(columns), 2), key=lambda k: len(set(columns[k])))
    names = ["".join("*" if k == counter else text for k, text in enumerate(row)) for row in parts]
    groups = _group(files, names)
    is_few = 1 < len(groups) <= _MAX_SENSORS and min(map(len, groups.values())) >= 3
    return groups if is_few else {}
