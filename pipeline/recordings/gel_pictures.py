"""What every reader of a gel's pictures does with them: which sensor, which size, and what they are compared to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image
from pipeline.recordings import differences, resampling
from pipeline.recordings.differences import Implied
from pipeline.recordings.resampling import Fit
from pipeline.recordings.sensor_guess import named_or_guessed
from pipeline.sensors.spec import SensorSpec
from pipeline.sensors.spec import sensor as sensor_spec


@dataclass(frozen=True, slots=True, kw_only=True)
class GelPictures:
    """How pictures of one size become the sensor's; made once for all frames of a stream."""

    sensor: str  # "" = not known
    reference: Image | None  # as frames have it
    notes: tuple[str, ...]
    fit: Fit | None
    implied: Implied | None

    def picture(self, raw: NDArray[np.generic]) -> Image:
        """(rows, cols, 3) uint8 of the sensor's size, as its camera takes it, from a picture as it is kept."""
        if self.implied is not None and raw.dtype != np.uint8:  # a signed difference, in grey levels
            raw = np.clip(np.rint(raw.astype(np.float32) + self.implied.centre), 0, 255).astype(np.uint8)
        sized: NDArray[np.generic] = raw if self.fit is None else self.fit.applied(np.asarray(raw, np.uint8))
        return np.asarray(sized, np.uint8) if self.implied is None else self.implied.picture(sized)


def gel_pictures(
    said: str, shape: tuple[int, int], reference: Image | None, first: Callable[[], NDArray[np.generic]]
) -> GelPictures:
    """How pictures of `shape` are read: `first` gives one of them as it is kept, uint8 or a signed difference.

    `said` names the sensor or is empty, `reference` is the untouched picture as it is kept. Raises SettingProblem for a
    sensor that is not known, and what `first` raises.
    """
    name, notes = named_or_guessed(said, shape, is_depth=False)
    spec = _spec(said or name)
    fit = None if spec is None else resampling.fit(spec, shape)
    centre = None if reference is not None else _centre(first())
    implied = None
    if centre is not None:
        implied = differences.implied(spec, shape if fit is None else fit.shape, centre)
        reference = implied.reference
    elif reference is not None and fit is not None:
        reference = fit.applied(reference)
    notes += () if fit is None else (fit.note,)
    notes += () if implied is None else (differences.NOTE,)
    return GelPictures(sensor=name, reference=reference, notes=notes, fit=fit, implied=implied)


def _centre(picture: NDArray[np.generic]) -> float | None:
    """The grey level of no change; a signed difference is brought to mid-grey before it is resampled."""
    if picture.dtype != np.uint8:
        return 128.0
    return differences.mid_grey(np.asarray(picture, np.uint8))


def _spec(name: str) -> SensorSpec | None:
    return sensor_spec(name) if name else None
