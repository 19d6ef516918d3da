"""Parse lists of frame numbers."""

import re

import numpy as np

from pipeline.core.errors import SettingProblem

_RANGE = re.compile(r"([0-9]{1,12})(?:-([0-9]{1,12}))?")


def check_frame_index(index: int, n_frames: int) -> int:
    """Return `index` if a recording of `n_frames` has it; raises SettingProblem otherwise."""
    if n_frames < 1:
        raise SettingProblem("the recording holds no frame; choose another")
    if not 0 <= index < n_frames:
        raise SettingProblem(f"no frame {index}; the recording has frames 0 to {n_frames - 1}")
    return index


def spread_indices(n: int, most: int, first: int = 0) -> list[int]:
    """Return at most `most` different numbers from `first` to `n` - 1, spread evenly."""
    count = min(most, n - first)
    return sorted({round(k) for k in np.linspace(first, n - 1, count)}) if count > 0 else []


def parse_frames(listed: str, n_frames: int) -> list[int]:
    """Return the frame numbers of a text such as `0,3-7`.

    All if it is empty. Raises SettingProblem.
    """
    check_frame_index(0, n_frames)
    if not listed.strip():
        return list(range(n_frames))
    frames: set[int] = set()
    for part in listed.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise SettingProblem(
                f"frames are given as numbers and ranges such as 0,3-7, got {listed[:40]!r}"
            )
        first = int(match[1])
        last = int(match[2] or match[1])
        check_frame_index(max(first, last), n_frames)
        if last < first:
            raise SettingProblem(
                "a range of frames goes from the smaller number to the larger, got "
                f"{part.strip()!r}"
            )
        frames.update(range(first, last + 1))
    return sorted(frames)
