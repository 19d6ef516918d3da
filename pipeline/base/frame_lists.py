"""Frames as people write them."""

from __future__ import annotations

import re

from pipeline.base.errors import SettingProblem

_RANGE = re.compile(r"([0-9]{1,12})(?:-([0-9]{1,12}))?")


def frames_of(listed: str, n_frames: int) -> list[int]:
    """Frame numbers of a text such as `0,3-7`; all of them if it is empty. Raises SettingProblem."""
    if not listed.strip():
        return list(range(n_frames))
    chosen: set[int] = set()
    for part in listed.split(","):
        words = _RANGE.fullmatch(part.strip())
        if words is None:
            raise SettingProblem(f"frames are given as numbers and ranges such as 0,3-7, got {listed[:40]!r}")
        first, last = int(words[1]), int(words[2] or words[1])
        if max(first, last) >= n_frames:
            raise SettingProblem(f"no frame {max(first, last)}; the recording has frames 0 to {n_frames - 1}")
        if last < first:
            raise SettingProblem(f"a range of frames goes from the smaller number to the larger, got {part.strip()!r}")
        chosen.update(range(first, last + 1))
    return sorted(chosen)
