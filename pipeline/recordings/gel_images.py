"""What all readers of gel images share: sensor, size and reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image
from pipeline.recordings import difference_images, resampling
from pipeline.recordings.difference_images import ImpliedReference
from pipeline.recordings.resampling import ResamplingFit
from pipeline.recordings.sensor_guess import resolve_sensor_name
from pipeline.sensors.spec import load_sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class GelImageConverter:
    """Converts images of one size to the sensor's; made once for all frames of a stream."""

    sensor: str  # "" = not known
    reference: Image | None  # (rows, cols, 3) of the sensor's size
    notes: tuple[str, ...]
    resampling_fit: ResamplingFit | None  # None = no resampling
    implied_reference: ImpliedReference | None  # None = the images are no differences

    def convert_image(self, raw: NDArray[np.generic]) -> Image:
        """The camera image (rows, cols, 3) uint8 of the sensor's size for a stored image."""
        if self.implied_reference is not None and raw.dtype != np.uint8:  # signed difference in grey levels
            raw = np.clip(np.rint(raw.astype(np.float32) + self.implied_reference.no_change_grey), 0, 255)
        image = np.asarray(raw, np.uint8)
        if self.resampling_fit is not None:
            image = self.resampling_fit.resample_image(image)
        return image if self.implied_reference is None else self.implied_reference.restore_image(image)


def make_gel_converter(
    sensor: str,
    shape: tuple[int, int],
    reference: Image | None,
    read_first: Callable[[], NDArray[np.generic]],
    *,
    file_names: Sequence[str] = (),
) -> GelImageConverter:
    """The converter for stored images of `shape` (rows, cols).

    `sensor` is the stated sensor or "", `reference` the stored reference image, `read_first` reads one stored image,
    uint8 or a signed difference; `file_names` of the images may name the sensor. Raises SettingProblem for an unknown
    sensor, and what `read_first` raises.
    """
    name, notes = resolve_sensor_name(sensor, shape, is_depth=False, file_names=file_names)
    spec = load_sensor(sensor or name) if sensor or name else None
    fit = None if spec is None else resampling.fit_resampling(spec, shape)
    no_change_grey = None if reference is not None else _find_no_change_grey(read_first())
    implied = None
    if no_change_grey is not None:
        implied = difference_images.derive_implied_reference(spec, shape if fit is None else fit.shape, no_change_grey)
        reference = implied.reference
    elif reference is not None and fit is not None:
        reference = fit.resample_image(reference)
    notes += () if fit is None else (fit.note,)
    notes += () if implied is None else (difference_images.DIFFERENCE_NOTE,)
    return GelImageConverter(
        sensor=name, reference=reference, notes=notes, resampling_fit=fit, implied_reference=implied
    )


def _find_no_change_grey(image: NDArray[np.generic]) -> float | None:
    """The grey level of no change; signed differences are shifted to mid-grey before resampling."""
    if image.dtype != np.uint8:
        return difference_images.MID_GREY
    return difference_images.estimate_no_change_grey(np.asarray(image, np.uint8))
