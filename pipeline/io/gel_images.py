"""What all readers of gel images share: sensor, size and reference.

Some training sets keep differences only, frames minus their reference, with mid-grey (or zero, in
floats) for no change. Slopes follow from the change relative to the reference brightness, so a
described reference is good enough.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Image, Reals, Stored, freeze
from pipeline.core.errors import FileProblem
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import TactileFrame
from pipeline.io import resampling
from pipeline.io.resampling import ResamplingFit
from pipeline.io.sensor_guess import resolve_sensor_name
from pipeline.sensors.parts import compute_reference_light
from pipeline.sensors.spec import SensorSpec, load_sensor

MID_GREY = 128.0  # grey level
_MAX_FROM_MID_GREY = 16.0  # grey levels of a pixel without change
# of the pixels of a difference; at most a third of a gel's reference image is mid-grey
_MIN_QUIET_SHARE = 0.5
# grey levels: range of an image that says nothing; mean between channels
_UNIFORM_GREY = 8
_MIN_COLOUR_GREY = 0.5
DIFFERENCE_NOTE = (
    "the images are differences from a reference (mid-grey or zero is no change); the reference "
    "follows from the "
    "sensor description, and a difference that was halved gives half the depth"
)


def estimate_no_change_grey(image: Image) -> float | None:
    """The grey level of no change in a difference image (rows, cols, 3).

    None for an image of a camera.
    """
    near = (np.abs(image.astype(np.float32) - MID_GREY) <= _MAX_FROM_MID_GREY).all(axis=2)
    return float(np.median(image[near])) if near.mean() > _MIN_QUIET_SHARE else None


def require_colour(images: Iterable[Image], path: Path) -> None:
    """Raise FileProblem where all images are grey; one that is uniform (black) says nothing."""
    textured = [image for image in images if int(image.max()) - int(image.min()) > _UNIFORM_GREY]
    if textured and all(
        float((image.max(axis=2) - image.min(axis=2)).mean(dtype=np.float64)) < _MIN_COLOUR_GREY
        for image in textured
    ):
        raise FileProblem(
            "the images are grey, and a gel's slopes are read from its colours: record or convert "
            "it in colour; depth "
            "is read from images of 16 bits",
            path,
        )


@frozen
class GelImageConverter:
    """Converts images of one size to the sensor's; made once for all frames of a stream."""

    sensor: str  # "" = not known
    # (rows, cols, 3) of the sensor's size; that which differences imply
    reference: Image | None
    notes: tuple[str, ...] = ()
    resampling_fit: ResamplingFit | None = None  # None = no resampling
    no_change_grey: float | None = None  # of a difference; None = the images are none

    def convert_image(self, raw: Stored) -> Image:
        """The camera image (rows, cols, 3) uint8 of the sensor's size for a stored image.

        Of a difference, restored.
        """
        stored = self._convert_stored(raw)
        if self.no_change_grey is None or self.reference is None:
            return stored
        change = stored.astype(np.float32) - np.float32(self.no_change_grey)
        return _round_grey(self.reference.astype(np.float32) + change)

    def _convert_stored(self, raw: Stored) -> Image:
        image = np.asarray(raw, np.uint8) if raw.dtype == np.uint8 else None
        if image is None:  # a signed difference in grey levels
            image = _round_grey(raw.astype(np.float32) + np.float32(self.no_change_grey or 0.0))
        return image if self.resampling_fit is None else self.resampling_fit.resample_image(image)

    def make_frame(
        self, raw: Stored, index: int, origin: str, time_s: float = math.nan
    ) -> TactileFrame:
        """The frame of a stored image, which holds a difference as it is stored too."""
        return TactileFrame(
            sensor=self.sensor,
            image=self.convert_image(raw),
            reference=self.reference,
            index=index,
            time_s=time_s,
            origin=origin,
            stored_image=None if self.no_change_grey is None else self._convert_stored(raw),
        )


def make_gel_converter(
    sensor: str,
    shape: tuple[int, int],
    reference: Image | None,
    read_first: Callable[[], Stored],
    *,
    file_names: Sequence[str] = (),
) -> GelImageConverter:
    """The converter for stored images of `shape` (rows, cols).

    `sensor` is the stated sensor or "", `reference` the stored reference image, `read_first` reads
    one stored image, uint8 or a signed difference; `file_names` of the images may name the sensor.
    Raises SettingProblem for an unknown sensor, and what `read_first` raises.
    """
    name, notes = resolve_sensor_name(sensor, shape, is_depth=False, file_names=file_names)
    spec = load_sensor(sensor or name) if sensor or name else None
    first = read_first() if reference is None else reference
    example = np.asarray(first, np.uint8) if first.dtype == np.uint8 else None
    fit = None if spec is None else resampling.fit_resampling(spec, shape, example)
    no_change_grey = None
    if reference is None:
        # signed differences are shifted to mid-grey before resampling
        no_change_grey = MID_GREY if example is None else estimate_no_change_grey(example)
    if fit is not None:
        notes += (fit.note,)
        shape = fit.shape
        reference = None if reference is None else fit.resample_image(reference)
    if no_change_grey is not None:
        notes += (DIFFERENCE_NOTE,)
        reference = _render_reference(spec, shape)
    return GelImageConverter(
        sensor=name,
        reference=reference,
        notes=notes,
        resampling_fit=fit,
        no_change_grey=no_change_grey,
    )


def _render_reference(spec: SensorSpec | None, shape: tuple[int, int]) -> Image:
    """The described reference image without markers.

    Plain mid-grey where the sensor or its optics are not known.
    """
    if spec is None or spec.optics is None or spec.camera.shape != shape:
        return _round_grey(np.full((*shape, 3), MID_GREY, np.float32))
    return _round_grey(compute_reference_light(spec.camera, spec.optics))


def _round_grey(grey: Reals) -> Image:
    return freeze(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
