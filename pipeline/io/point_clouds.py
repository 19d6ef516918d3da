"""Recordings of Punyo's force estimation: a folder of organised point clouds `pc_<n>.npy` of a
depth camera, in metres.

Each cloud (rows * cols, 3) is in row order, so that z is the depth and the rays give the camera.
"""

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, freeze
from pipeline.core.errors import CalibrationError, FileProblem
from pipeline.core.files import read_arrays
from pipeline.core.geometry.camera import Camera, make_camera
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io.depth_arrays import estimate_reference
from pipeline.io.file_names import natural_sort_key
from pipeline.io.formats import with_index_check
from pipeline.io.sensor_guess import resolve_sensor_name

_CLOUD_NAME = re.compile(r"^pc_\d+\.npy$")
# (rows, cols) of depth cameras
_SHAPES = ((480, 640), (480, 848), (720, 1280), (240, 320), (171, 224))
_MM_PER_M = np.float32(1000.0)
# median distance of a ray from its pixel, beyond which the points count as unordered
_MAX_RESIDUAL_PX = 1.0
_MIN_POINTS = 100  # for the fit of a camera


def is_cloud_folder(folder: Path) -> bool:
    """Whether the folder holds point clouds."""
    return any(_CLOUD_NAME.match(p.name) for p in folder.iterdir())


def read(folder: Path) -> Recording:
    """One stream of float32 depth in mm, NaN where there is no value, with the camera fitted to the
    points.

    The median of the first frames is the reference. Raises FileProblem.
    """
    files = sorted(
        (p for p in folder.iterdir() if _CLOUD_NAME.match(p.name)),
        key=lambda p: natural_sort_key(p.stem),
    )
    first = _read_points(files[0])
    shape = next((s for s in _SHAPES if s[0] * s[1] == len(first)), None)
    if shape is None:
        raise FileProblem(
            f"{len(first)} points fit no image size of a known depth camera", files[0]
        )
    camera = _fit_camera(first, shape, files[0])
    name, notes = resolve_sensor_name("", shape, is_depth=True)

    @lru_cache(maxsize=2)
    def depth_mm(index: int) -> Floats:
        points = _read_points(files[index])
        if len(points) != len(first):
            raise FileProblem(
                f"frame {index} has {len(points)} points, the others {len(first)}", files[index]
            )
        z = points[:, 2].reshape(shape) * _MM_PER_M
        return freeze(np.where(np.isfinite(z) & (z > 0), z, np.float32(np.nan)).astype(np.float32))

    n = len(files)
    reference, about = estimate_reference(depth_mm, n)

    def frame(index: int) -> TactileFrame:
        return TactileFrame(
            sensor=name,
            image=depth_mm(index),
            reference=reference,
            index=index,
            camera=camera,
            origin=str(files[index]),
        )

    notes += (f"the camera follows from the points: focal length {camera.fx_px:.1f} px", about)
    stream = Stream(name=name, sensor=name, n_frames=n, frame=with_index_check(frame, n, folder))
    return Recording(
        path=folder, format="point clouds of a depth camera", streams=(stream,), notes=notes
    )


def _read_points(file: Path) -> NDArray[np.float32]:
    (array,) = read_arrays(file, "the point cloud").values()
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind != "f":
        raise FileProblem(
            f"a point cloud must have shape (points, 3) in metres, got {array.shape}", file
        )
    return np.asarray(array, np.float32)


def _fit_camera(points: NDArray[np.float32], shape: tuple[int, int], file: Path) -> Camera:
    """The pinhole camera that sees the points pixel by pixel: x / z = (column - cx) / fx, and
    likewise y.
    """
    row, col = (a.ravel().astype(np.float64) for a in np.indices(shape))
    known = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
    if known.sum() < _MIN_POINTS:
        raise FileProblem("the point cloud has too few values to fit its camera", file)
    x, y, z = points[known].astype(np.float64).T
    fits: list[tuple[float, float]] = []
    for ray, pixel in ((x / z, col[known]), (y / z, row[known])):
        focal, centre = (float(v) for v in np.polyfit(ray, pixel, 1))
        residual_px = float(np.median(np.abs(focal * ray + centre - pixel)))
        if not (focal > 0 and residual_px <= _MAX_RESIDUAL_PX):
            raise FileProblem(
                f"the points are not in the order of an image's pixels ({residual_px:.0f} px off)",
                file,
            )
        fits.append((focal, centre))
    (fx_px, cx_px), (fy_px, cy_px) = fits
    try:
        return make_camera(
            [[fx_px, 0, cx_px], [0, fy_px, cy_px], [0, 0, 1]],
            *shape,
            what="the camera of the points",
        )
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{file}'") from error
