"""Images of a sensor at another size than its description, calibration table and network have.

Gel images are resampled to the described size. Depth images are not, since interpolation would
invent depth across jumps and gaps; their camera is fitted to the image instead.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Image, describe_size, freeze
from pipeline.core.errors import StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.sensors.parts import compute_reference_light
from pipeline.sensors.spec import SensorSpec

_RATIO_TOLERANCE = 0.05  # relative, between width over height of two sizes of one image
_MAX_TILE_PX = 256  # side of the squares that data sets squeeze images to for a network
# (rows, cols) of the camera below; at another size its vignette tells what is cropped
_FULL_CAMERA = (2464, 3280)
# sensor -> share of the camera image that its driver crops per side
_CROP_SHARES = {"gelsight_mini": 1 / 7}
# of the brightness of each border over the middle; four real Minis differ by 0.05
_VIGNETTE_TOLERANCE = 0.1
_STEREO_FOCAL_PX = 434.0  # of a RealSense at 640 x 480, fitted to the K of Punyo's recordings
_STEREO_ROWS = 480
_STEREO_RATIOS = (4 / 3, 848 / 480, 16 / 9)
# (rows, cols) of the full image; soft_bubble's window in it
_TOF_SHAPE = (171, 224)
_TOF_CORNER = (20, 25)


@frozen
class ResamplingFit:
    """Resampling of gel images of one size to the sensor's size."""

    shape: tuple[int, int]  # (rows, cols) of the sensor
    note: str
    crop_share: float = 0.0  # of rows and cols, cropped at each side
    is_rotated: bool = False  # by 90 degrees to the left, as DIGIT's driver does

    def resample_image(self, image: Image) -> Image:
        """The image (rows, cols, 3) at the sensor's size."""
        return freeze(np.asarray(self._resample(image), np.uint8))

    def resample_field(self, field: Floats) -> Floats:
        """A field (rows, cols) of such an image at the sensor's size."""
        return freeze(np.asarray(self._resample(field), np.float32))

    def _resample(self, array: NDArray[Any]) -> NDArray[Any]:
        import cv2

        rows, cols = (round(n * self.crop_share) for n in array.shape[:2])
        part = array[rows : array.shape[0] - rows, cols : array.shape[1] - cols]
        part = np.rot90(part) if self.is_rotated else part
        interpolation = cv2.INTER_AREA if part.shape[0] > self.shape[0] else cv2.INTER_LINEAR
        return cv2.resize(np.ascontiguousarray(part), self.shape[::-1], interpolation=interpolation)


def fit_resampling(
    spec: SensorSpec, shape: tuple[int, int], image: Image | None = None
) -> ResamplingFit | None:
    """The resampling of images of `shape` (rows, cols) to a gel sensor's size.

    None if not needed or not possible.

    `image` is one of them: where the sensor's driver crops the camera image, its vignette tells
    whether it did.
    """
    size = spec.camera.shape
    if spec.sensor_kind.is_depth or shape == size:
        return None
    ratio = shape[1] / shape[0]
    sensor_ratio = size[1] / size[0]
    stored = describe_size(shape)
    resampled = f"resampled to the {describe_size(size)} of {spec.name}"
    to = f"{resampled}, {spec.pixel_mm:.4f} mm each"
    if _is_close(ratio, sensor_ratio):
        how = f"images of {stored} are {to}"
        cut = _CROP_SHARES.get(spec.name, 0.0)
        share = 0.0
        if cut:
            is_cropped = None if image is None else _find_cropped(image, spec, cut)
            if shape == _FULL_CAMERA or is_cropped is False:
                share = cut
                how = (
                    f"images of {stored} are the full camera image; a seventh is cropped at each "
                    f"side, the rest is {to}"
                )
            elif is_cropped:
                how = f"{how}; by their vignette they are cropped as by its driver"
            else:
                how = StageWarning(
                    f"{how}; if they are the full camera image, which their vignette does not "
                    "tell, sizes are 29 % too small: then crop a seventh at each side before"
                )
        return ResamplingFit(shape=size, crop_share=share, note=how)
    if _is_close(1 / ratio, sensor_ratio):
        note = f"images of {stored} lie on their side; rotated by 90 degrees to the left and {to}"
        return ResamplingFit(shape=size, is_rotated=True, note=note)
    if ratio == 1.0 and max(shape) <= _MAX_TILE_PX:
        note = StageWarning(
            f"tiles of {stored} have no millimetres: they are taken as whole images squeezed to a "
            f"square and {resampled}, so that lengths and depths are not to scale"
        )
        return ResamplingFit(shape=size, note=note)
    return None


def _find_cropped(image: Image, spec: SensorSpec, cut: float) -> bool | None:
    """Whether an image is cropped as the description says, by its vignette.

    None where it does not tell.
    """
    if spec.optics is None:
        return None
    want = _compute_vignette(compute_reference_light(spec.camera, spec.optics), cut)
    rows, cols = (round(n * cut) for n in image.shape[:2])
    parts = (image, image[rows : image.shape[0] - rows, cols : image.shape[1] - cols])
    whole, inner = (float(np.abs(_compute_vignette(part, cut) - want).max()) for part in parts)
    if min(whole, inner) > _VIGNETTE_TOLERANCE:
        return None
    return whole <= _VIGNETTE_TOLERANCE  # what is left of a cropped image may look like it


def _compute_vignette(image: NDArray[Any], share: float) -> Doubles:
    """Brightness of each border (4,) over that of the middle, for borders of a share of rows and
    cols.
    """
    grey = image.mean(axis=2, dtype=np.float64)
    rows, cols = (round(n * share) for n in grey.shape)
    borders = (grey[:rows], grey[-rows:], grey[:, :cols], grey[:, -cols:])
    return np.array([border.mean() for border in borders]) / max(
        float(grey[rows:-rows, cols:-cols].mean()), 1.0
    )


def infer_depth_camera(
    spec: SensorSpec, shape: tuple[int, int]
) -> tuple[Camera | None, tuple[str, ...]]:
    """(camera, notes) for depth images of `shape` without one.

    None where the sensor's camera or none fits.
    """
    own = spec.camera
    if not spec.sensor_kind.is_depth or shape == own.shape:
        return None, ()
    size = describe_size(shape)
    exact = "a matrix K in the file would be exact"
    if own.shape == (140, 175) and shape == _TOF_SHAPE:
        camera = own.crop(-_TOF_CORNER[0], -_TOF_CORNER[1], *shape)
        return camera, (f"depth of {size} is the full image of which {spec.name} is a window",)
    if _is_close(shape[1] / shape[0], own.cols / own.rows, 0.01):
        note = f"depth of {size}: the camera of {spec.name} is scaled to it; {exact}"
        return own.resize(*shape), (note,)
    if any(_is_close(shape[1] / shape[0], ratio, 0.01) for ratio in _STEREO_RATIOS):
        f_px = _STEREO_FOCAL_PX * shape[0] / _STEREO_ROWS
        rows, cols = shape
        camera = Camera(
            rows=rows,
            cols=cols,
            fx_px=f_px,
            fy_px=f_px,
            cx_px=(cols - 1) / 2,
            cy_px=(rows - 1) / 2,
        )
        note = (
            f"depth of {size} is taken as that of a RealSense with a focal length of about "
            f"{f_px:.0f} px; {exact}"
        )
        return camera, (note,)
    return None, ()


def _is_close(ratio: float, expected: float, tolerance: float = _RATIO_TOLERANCE) -> bool:
    return abs(ratio / expected - 1.0) <= tolerance
