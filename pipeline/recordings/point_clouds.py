"""Recordings of Punyo's force estimation: a folder of organised point clouds `pc_<n>.npy`, metres, of a depth camera.

Every cloud (rows * cols, 3) is a picture in reading order, so that its z is the depth and its rays tell the camera.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.files import read_arrays
from pipeline.geometry.camera import Camera
from pipeline.recordings import image_files
from pipeline.recordings.depth_arrays import compute_median_depth, describe_first_frames
from pipeline.recordings.folder_contents import is_point_cloud_file
from pipeline.recordings.index_check import with_index_check
from pipeline.recordings.sensor_guess import resolve_sensor_name
from pipeline.values.frames import Recording, Stream, TactileFrame

_SHAPES = ((480, 640), (480, 848), (720, 1280), (240, 320), (171, 224))  # of depth cameras
_MM_PER_M = np.float32(1000.0)
_ASTRAY_PX = 1.0  # by which a ray may miss its pixel before the points count as unordered
_FEWEST = 100  # points that tell a camera
_N_UNTOUCHED = 5


def read(folder: Path, *, sensor: str = "") -> Recording:
    """One stream of float32 depth in mm, NaN where there is no reading, with the camera that the points tell.

    The median of the first frames is taken as untouched, and noted. Raises FileProblem.
    """
    files = sorted(filter(is_point_cloud_file, folder.iterdir()), key=image_files.natural_sort_key)
    first = _points(files[0])
    shape = next((s for s in _SHAPES if s[0] * s[1] == len(first)), None)
    if shape is None:
        raise FileProblem(f"{len(first)} points are no whole picture of a depth camera that is known", files[0])
    camera = _camera(first, shape, files[0])
    name, notes = resolve_sensor_name(sensor, shape, is_depth=True)

    @lru_cache(maxsize=2)
    def depth_mm(index: int) -> Floats:
        points = _points(files[index])
        if len(points) != len(first):
            raise FileProblem(f"frame {index} has {len(points)} points, the others {len(first)}", files[index])
        z = points[:, 2].reshape(shape) * _MM_PER_M
        return freeze(np.where(np.isfinite(z) & (z > 0), z, np.float32(np.nan)).astype(np.float32))

    n = len(files)
    n_first = min(_N_UNTOUCHED, max(1, n // 6))
    untouched = compute_median_depth(np.stack([depth_mm(i) for i in range(n_first)]))

    def frame(index: int) -> TactileFrame:
        return TactileFrame(sensor=name, image=depth_mm(index), reference=untouched, index=index, camera=camera,
                            origin=str(files[index]))  # fmt: skip

    told = (
        f"the camera follows from the points: focal length {camera.fx_px:.1f} px",
        describe_first_frames(n_first),
    )
    stream = Stream(name=name, sensor=name, n_frames=n, frame=with_index_check(frame, n, folder))
    return Recording(path=folder, format="point clouds of a depth camera", streams=(stream,), notes=(*notes, *told))


def _points(file: Path) -> NDArray[np.float32]:
    (array,) = read_arrays(file, "the point cloud").values()
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind != "f":
        raise FileProblem(f"a point cloud must have shape (points, 3) in metres, got {array.shape}", file)
    return np.asarray(array, np.float32)


def _camera(points: NDArray[np.float32], shape: tuple[int, int], file: Path) -> Camera:
    """The pinhole through which the points are seen pixel by pixel: x / z = (column - cx) / fx, and so for y."""
    row, col = (a.ravel().astype(np.float64) for a in np.indices(shape))
    seen = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
    if seen.sum() < _FEWEST:
        raise FileProblem("the point cloud has too few readings to tell its camera", file)
    x, y, z = points[seen].astype(np.float64).T
    found: list[tuple[float, float]] = []
    for ray, pixel in ((x / z, col[seen]), (y / z, row[seen])):
        focal, centre = (float(v) for v in np.polyfit(ray, pixel, 1))
        astray = float(np.median(np.abs(focal * ray + centre - pixel)))
        if not (focal > 0 and astray <= _ASTRAY_PX):
            raise FileProblem(f"the points do not lie in the order of a picture's pixels ({astray:.0f} px off)", file)
        found.append((focal, centre))
    (fx_px, cx_px), (fy_px, cy_px) = found
    return Camera(rows=shape[0], cols=shape[1], fx_px=fx_px, fy_px=fy_px, cx_px=cx_px, cy_px=cy_px)
