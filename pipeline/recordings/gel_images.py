"""What every reader of a gel's pictures does with them: which sensor, which size, and what they are compared to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image
from pipeline.recordings import difference_images, resampling
from pipeline.recordings.difference_images import ImpliedReference
from pipeline.recordings.resampling import ResamplingFit
from pipeline.recordings.sensor_guess import resolve_sensor_name
from pipeline.sensors.spec import SensorSpec
from pipeline.sensors.spec import load_sensor as sensor_spec


@dataclass(frozen=True, slots=True, kw_only=True)
class GelImageConverter:
    """How pictures of one size become the sensor's; made once for all frames of a stream."""

    sensor: str  # "" = not known
    reference: Image | None  # as frames have it
    notes: tuple[str, ...]
    resampling_fit: ResamplingFit | None
    implied_reference: ImpliedReference | None

    def convert_image(self, raw: NDArray[np.generic]) -> Image:
        """(rows, cols, 3) uint8 of the sensor's size, as its camera takes it, from a picture as it is kept."""
        if self.implied_reference is not None and raw.dtype != np.uint8:  # a signed difference, in grey levels
            raw = np.clip(np.rint(raw.astype(np.float32) + self.implied_reference.no_change_grey), 0, 255).astype(
                np.uint8
            )
        sized: NDArray[np.generic] = (
            raw if self.resampling_fit is None else self.resampling_fit.resample_image(np.asarray(raw, np.uint8))
        )
        return (
            np.asarray(sized, np.uint8)
            if self.implied_reference is None
            else self.implied_reference.restore_image(sized)
        )


def make_gel_converter(
    said: str, shape: tuple[int, int], reference: Image | None, first: Callable[[], NDArray[np.generic]]
) -> GelImageConverter:
    """How pictures of `shape` are read: `first` gives one of them as it is kept, uint8 or a signed difference.

    `said` names the sensor or is empty, `reference` is the untouched picture as it is kept. Raises SettingProblem for a
    sensor that is not known, and what `first` raises.
    """
    name, notes = resolve_sensor_name(said, shape, is_depth=False)
    spec = _spec(said or name)
    fit = None if spec is None else resampling.fit_resampling(spec, shape)
    centre = None if reference is not None else _centre(first())
    implied = None
    if centre is not None:
        implied = difference_images.derive_implied_reference(spec, shape if fit is None else fit.shape, centre)
        reference = implied.reference
    elif reference is not None and fit is not None:
        reference = fit.resample_image(reference)
    notes += () if fit is None else (fit.note,)
    notes += () if implied is None else (difference_images.DIFFERENCE_NOTE,)
    return GelImageConverter(
        sensor=name, reference=reference, notes=notes, resampling_fit=fit, implied_reference=implied
    )


def _centre(picture: NDArray[np.generic]) -> float | None:
    """The grey level of no change; a signed difference is brought to mid-grey before it is resampled."""
    if picture.dtype != np.uint8:
        return 128.0
    return difference_images.estimate_no_change_grey(np.asarray(picture, np.uint8))


def _spec(name: str) -> SensorSpec | None:
    return sensor_spec(name) if name else None
