"""Live source: the newest complete image of a folder that another program writes into."""

import contextlib
import os
import time
from pathlib import Path

import numpy as np

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.live.source import LiveFrame, LiveSourceLost
from pipeline.recordings import image_files
from pipeline.recordings.gel_images import GelImageConverter, make_gel_converter

_POLL_S = 0.05
_N_POLLS = 4  # before `read` returns None
_DAMAGED_AFTER_S = 2.0  # age of an unreadable image that counts as damaged, not as being written
_CLOCK_STEP_NS = 3_000_000_000  # of a file system's times; FAT has the largest, 2 s


class FolderSource:
    """Images of one size that appear after the source is opened."""

    touching_object = None  # not known

    def __init__(self, folder: Path, *, sensor: str = "") -> None:
        self._folder, self._sensor = folder, sensor
        self._converter: GelImageConverter | None = None
        self._shape: tuple[int, ...] = ()
        self._passed: set[str] = set()
        self._quiet_since_ns = -1  # the folder's time of change when a look found nothing new
        self._number = 0

    @property
    def title(self) -> str:
        """Name for people."""
        return f"images in {self._folder.name}"

    @property
    def sensor(self) -> str:
        """The stated sensor, or the one guessed from the first image's size; "" before."""
        return self._sensor or (self._converter.sensor if self._converter is not None else "")

    def open(self) -> None:
        """List the images that are there; raises LiveSourceLost without the folder."""
        if not self._folder.is_dir():
            raise LiveSourceLost(f"there is no folder '{self._folder}'; trying again")
        if not self._passed:
            self._passed = {name for name, _ in self._list_new_images()}

    def read(self) -> LiveFrame | None:
        """The newest complete image; older new ones count as lost. None if none came."""
        for _ in range(_N_POLLS):
            new = self._list_new_images()
            for n_newer, (name, taken_s) in enumerate(reversed(new)):
                image = self._read_image(self._folder / name, taken_s)
                if image is not None:
                    self._passed |= {old for old, _ in new[: len(new) - n_newer]}
                    self._number += len(new) - n_newer
                    return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=self._number)
            time.sleep(_POLL_S)
        return None

    def close(self) -> None:
        """Nothing to release."""

    def _list_new_images(self) -> list[tuple[str, float]]:
        """(name, time written in s) of the images that were not passed, oldest first.

        Listing 50,000 names takes 25 ms, so a folder that has not changed since nothing was new is not listed.
        """
        looked_ns = time.time_ns()
        try:
            changed_ns = self._folder.stat().st_mtime_ns
            if changed_ns == self._quiet_since_ns:
                return []
            with os.scandir(self._folder) as entries:
                found = [
                    (e.stat().st_mtime_ns, e.name)
                    for e in entries
                    if e.name not in self._passed and e.is_file() and image_files.is_image_file(Path(e.name))
                ]
        except OSError:
            raise LiveSourceLost(f"the folder '{self._folder}' is gone; trying again") from None
        if not found and looked_ns - changed_ns > _CLOCK_STEP_NS:
            self._quiet_since_ns = changed_ns
        return [(name, written_ns * 1e-9) for written_ns, name in sorted(found)]

    def _read_image(self, path: Path, written_s: float) -> np.ndarray | None:
        """The image; None while it is written, and for one that is damaged or of another size, which is skipped."""
        try:
            raw = image_files.read_rgb(path)
        except FileProblem:
            if time.time() - written_s > _DAMAGED_AFTER_S:
                self._passed.add(path.name)
            return None
        if self._converter is None:
            converter = make_gel_converter(self._sensor, (raw.shape[0], raw.shape[1]), None, lambda: raw)
            if not converter.sensor:
                size = f"{raw.shape[1]} x {raw.shape[0]} px"
                raise SettingProblem(f"no known sensor has images of {size}; give --sensor")
            self._converter, self._shape = converter, raw.shape
        if raw.shape != self._shape:
            self._passed.add(path.name)
            return None
        with contextlib.suppress(OSError):
            return self._converter.convert_image(raw)
        return None
