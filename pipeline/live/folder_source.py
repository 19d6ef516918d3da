"""A folder that another program writes pictures into: the newest whole one is what the sensor sees."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

import numpy as np

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.live.source import LiveFrame, LiveSourceLost
from pipeline.recordings import image_files
from pipeline.recordings.gel_images import GelImageConverter, make_gel_converter

_LOOK_EVERY_S = 0.05
_LOOKS = 4  # before `read` comes back with nothing
_UNREADABLE_S = 2.0  # a picture that cannot be read for so long is not being written, it is damaged


class FolderSource:
    """Pictures of one size; those that were there before are not shown."""

    def __init__(self, folder: Path, *, sensor: str = "") -> None:
        self._folder, self._said = folder, sensor
        self._made: GelImageConverter | None = None
        self._shape: tuple[int, ...] = ()
        self._seen: set[str] = set()
        self._number = 0

    @property
    def title(self) -> str:
        """What it is, in words."""
        return f"pictures in {self._folder.name}"

    @property
    def sensor(self) -> str:
        """The sensor that was said, or that the first picture's size tells."""
        return self._said or (self._made.sensor if self._made is not None else "")

    @property
    def touching_object(self) -> None:
        """Nobody knows."""

    def open(self) -> None:
        """Note what is there; raises SourceLost without such a folder."""
        if not self._folder.is_dir():
            raise LiveSourceLost(f"there is no folder '{self._folder}'; it is looked for again")
        if not self._seen:
            self._seen = {name for name, _ in self._names()}

    def read(self) -> LiveFrame | None:
        """The newest picture that is whole; older ones that came meanwhile count as lost."""
        for _ in range(_LOOKS):
            new = [(name, taken_s) for name, taken_s in self._names() if name not in self._seen]
            for behind, (name, taken_s) in enumerate(reversed(new)):
                image = self._picture(self._folder / name, taken_s)
                if image is not None:
                    self._seen |= {old for old, _ in new[: len(new) - behind]}
                    self._number += len(new) - behind
                    return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=self._number)
            time.sleep(_LOOK_EVERY_S)
        return None

    def close(self) -> None:
        """Nothing to let go of."""

    def _names(self) -> list[tuple[str, float]]:
        """Pictures in the order in which they were written."""
        try:
            with os.scandir(self._folder) as entries:
                found = [(e.stat().st_mtime_ns, e.name) for e in entries if e.is_file() and _is_picture(e.name)]
        except OSError:
            raise LiveSourceLost(f"the folder '{self._folder}' is gone; it is looked for again") from None
        return [(name, written_ns * 1e-9) for written_ns, name in sorted(found)]

    def _picture(self, path: Path, written_s: float) -> np.ndarray | None:
        """None while it is being written; one that stays damaged is passed over, as one of another size is."""
        try:
            raw = image_files.read_rgb(path)
        except FileProblem:
            if time.time() - written_s > _UNREADABLE_S:
                self._seen.add(path.name)
            return None
        if self._made is None:
            made = make_gel_converter(self._said, (raw.shape[0], raw.shape[1]), None, lambda: raw)
            if not made.sensor:
                size = f"{raw.shape[1]} x {raw.shape[0]} px"
                raise SettingProblem(f"which sensor takes pictures of {size}? say it with --sensor")
            self._made, self._shape = made, raw.shape
        if raw.shape != self._shape:
            self._seen.add(path.name)
            return None
        with contextlib.suppress(OSError):
            return self._made.convert_image(raw)
        return None


def _is_picture(name: str) -> bool:
    return not name.startswith(".") and Path(name).suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
