"""Pictures of the right sensor at another size: brought to the one that its description, look-up and network know.

A gel's picture is resampled, so that its millimetres per pixel are the sensor's own. Depth is not: readings between
others would be invented across jumps and gaps, and so the camera is made to fit the picture instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Image, freeze
from pipeline.geometry.camera import Camera
from pipeline.sensors.spec import SensorSpec

_SAME_SHAPE = 0.05  # share by which width over height may differ between two sizes of one picture
_TILE_PX = 256  # squares up to this side are what data sets squeeze pictures to for a network
_WHOLE_CAMERA = {(2464, 3280): ("gelsight_mini", 1 / 7)}  # size -> whose, and what its driver cuts off each side
_STEREO_PX = 434.0  # focal length of a RealSense at 640 x 480, where the file does not give it (fitted K of Punyo's)
_STEREO_ROWS, _STEREO_RATIOS = 480, (4 / 3, 848 / 480, 16 / 9)
_FLIGHT_SHAPE, _FLIGHT_CORNER = (171, 224), (20, 25)  # the whole picture of which soft_bubble's is a window


@dataclass(frozen=True, slots=True, kw_only=True)
class ResamplingFit:
    """How a gel's picture of one size becomes one of the sensor's."""

    shape: tuple[int, int]  # (rows, cols) of the sensor
    crop_share: float  # share of each side that is left away
    is_rotated: bool  # a quarter to the left, as DIGIT's own driver does
    note: str

    def resample_image(self, image: Image) -> Image:
        """(rows, cols, 3) of the sensor's size."""
        import cv2

        rows, cols = (round(n * self.crop_share) for n in image.shape[:2])
        part = image[rows : image.shape[0] - rows, cols : image.shape[1] - cols]
        part = np.rot90(part) if self.is_rotated else part
        smaller = part.shape[0] > self.shape[0]
        way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        resized = cv2.resize(np.ascontiguousarray(part), self.shape[::-1], interpolation=way)
        return freeze(np.asarray(resized, np.uint8))


def fit_resampling(spec: SensorSpec, shape: tuple[int, int]) -> ResamplingFit | None:
    """What brings pictures of `shape` to the size of a gel; None where they have it, or are not this sensor's."""
    wanted = spec.camera.shape
    if spec.kind != "gel" or shape == wanted:
        return None
    owner, cut = _WHOLE_CAMERA.get(shape, ("", 0.0))
    cut = cut if owner == spec.name else 0.0
    ratio, want = shape[1] / shape[0], wanted[1] / wanted[0]
    size = f"{shape[1]} x {shape[0]} px"
    to = f"resampled to the {wanted[1]} x {wanted[0]} px of {spec.name}, {spec.pixel_mm:.4f} mm each"
    if _alike(ratio, want):
        how = f"pictures of {size} are {to}"
        if cut:
            how = f"pictures of {size} are the camera's whole; a seventh is cut off each side, and the rest is {to}"
        return ResamplingFit(shape=wanted, crop_share=cut, is_rotated=False, note=how)
    if _alike(1 / ratio, want):
        note = f"pictures of {size} lie on their side; turned a quarter to the left as the driver does, and {to}"
        return ResamplingFit(shape=wanted, crop_share=0.0, is_rotated=True, note=note)
    if ratio == 1.0 and max(shape) <= _TILE_PX:
        note = f"tiles of {size} are taken to be whole pictures squeezed to a square, and {to}"
        return ResamplingFit(shape=wanted, crop_share=0.0, is_rotated=False, note=note)
    return None


def infer_depth_camera(spec: SensorSpec, shape: tuple[int, int]) -> tuple[Camera | None, tuple[str, ...]]:
    """(camera, notes) of a bubble's depth pictures that bring none; None where the sensor's own or none fits."""
    own = spec.camera
    if spec.kind != "bubble" or shape == own.shape:
        return None, ()
    size, exact = f"{shape[1]} x {shape[0]} px", "a matrix K beside the depth would be exact"
    if own.shape == (140, 175) and shape == _FLIGHT_SHAPE:
        camera = own.crop(-_FLIGHT_CORNER[0], -_FLIGHT_CORNER[1], *shape)
        return camera, (f"depth of {size} is the whole picture of which {spec.name} is a window",)
    if _alike(shape[1] / shape[0], own.cols / own.rows, 0.01):
        note = f"depth of {size}: the camera of {spec.name} is scaled to it; {exact}"
        return own.resize(*shape), (note,)
    if any(_alike(shape[1] / shape[0], ratio, 0.01) for ratio in _STEREO_RATIOS):
        f_px = _STEREO_PX * shape[0] / _STEREO_ROWS
        camera = Camera(rows=shape[0], cols=shape[1], fx_px=f_px, fy_px=f_px,
                        cx_px=(shape[1] - 1) / 2, cy_px=(shape[0] - 1) / 2)  # fmt: skip
        note = f"depth of {size} is taken to be a RealSense's, whose focal length is about {f_px:.0f} px; {exact}"
        return camera, (note,)
    return None, ()


def _alike(ratio: float, wanted: float, share: float = _SAME_SHAPE) -> bool:
    return abs(ratio / wanted - 1.0) <= share
