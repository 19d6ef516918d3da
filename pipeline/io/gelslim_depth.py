"""The gelslim_depth data set: one `.pt` file of many grasps, both fingers in the channels.

Keys and shapes are those of the published data: `tactile_image`, `base_tactile_image` (n, 6, 320,
427) with the left finger's RGB before the right one's, `depth_image` (n, 2, 320, 427) in mm: 0
without contact, negative where pressed. Images of another size, as the package's own networks take
them, are resampled to the sensor's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import describe_size, freeze
from pipeline.core.errors import FileProblem
from pipeline.core.values.frames import Recording, Stream, TactileFrame, Truth
from pipeline.io import resampling, torch_files
from pipeline.io.formats import with_index_check
from pipeline.io.resampling import ResamplingFit
from pipeline.sensors.spec import load_sensor

_FINGERS = ("left", "right")
_MAX_DEPTH_MM = 10.0  # a gel of 2 mm gives way by less; more means another unit
_SIGN_TOLERANCE_MM = 0.05  # interpolation leaves a little above zero


def read(path: Path) -> Recording:
    """Two streams, `left` and `right`.

    The truth is indentation_mm = -depth_image where the file has one.

    Raises FileProblem for a missing key, or images whose sides have another ratio than the
    sensor's.
    """
    tensors = torch_files.load_tensors(path)
    images = torch_files.require_tensor(tensors, "tactile_image", path, (None, 6, None, None))
    shape = int(images.shape[2]), int(images.shape[3])
    fit = _fit_size(shape, path)
    base = torch_files.require_tensor_rows(tensors, "base_tactile_image", path, (6, *shape))
    # The data set's readme has the plural, its files the singular.
    depth_key = next((k for k in ("depth_image", "depth_images") if k in tensors), "")
    depth = (
        torch_files.require_tensor(tensors, depth_key, path, (None, 2, *shape))
        if depth_key
        else None
    )
    n = int(images.shape[0])
    if len(base) not in (1, n) or (depth is not None and len(depth) != n):
        raise FileProblem(
            f"tactile_image has {n} grasps, but base_tactile_image or {depth_key} another number",
            path,
        )

    def stream(finger: int) -> Stream:
        channels = slice(3 * finger, 3 * finger + 3)

        def frame(index: int) -> TactileFrame:
            image, reference = (
                torch_files.convert_to_rgb(tensor, key, path)
                for tensor, key in (
                    (images[index, channels], "tactile_image"),
                    (base[min(index, len(base) - 1), channels], "base_tactile_image"),
                )
            )
            if fit is not None:
                image = fit.resample_image(image)
                reference = fit.resample_image(reference)
            return TactileFrame(
                sensor="gelslim",
                image=image,
                reference=reference,
                index=index,
                origin=f"{path} [{_FINGERS[finger]}]",
                grasp_range=(float(images[index].min()), float(images[index].max())),
            )

        def truth(index: int) -> Truth | None:
            return (
                None if depth is None else _truth(depth[index, finger], index, depth_key, path, fit)
            )

        return Stream(
            name=_FINGERS[finger],
            sensor="gelslim",
            n_frames=n,
            has_truth=depth is not None,
            frame=with_index_check(frame, n, path),
            truth=with_index_check(truth, n, path),
        )

    return Recording(
        path=path,
        format="gelslim_depth dictionary",
        streams=(stream(0), stream(1)),
        notes=_notes(tensors, fit),
    )


def _fit_size(shape: tuple[int, int], path: Path) -> ResamplingFit | None:
    """The resampling of images of this size.

    None for the sensor's own. Raises FileProblem for other proportions.
    """
    sensor = load_sensor("gelslim")
    fit = resampling.fit_resampling(sensor, shape)
    size = sensor.camera.shape
    if shape == size or (fit is not None and not fit.is_rotated):
        return fit
    raise FileProblem(
        f"tactile_image has {describe_size(shape)}; images of {sensor.title} have "
        f"{describe_size(size)}, or another size of the same proportions: crop them",
        path,
    )


def _truth(depth: Any, index: int, key: str, path: Path, fit: ResamplingFit | None) -> Truth:
    values = depth.float().numpy()
    if not np.isfinite(values).all():
        raise FileProblem(f"{key} of frame {index} has values that are not finite", path)
    low = float(values.min())
    high = float(values.max())
    if high > _SIGN_TOLERANCE_MM:
        raise FileProblem(f"{key} of frame {index} must not be positive, got {high:g} mm", path)
    if low < -_MAX_DEPTH_MM:
        raise FileProblem(f"{key} of frame {index} must be in mm, got {low:g}", path)
    indentation = np.maximum(-values, 0.0, dtype=np.float32)
    return Truth(
        indentation_mm=freeze(indentation if fit is None else fit.resample_field(indentation))
    )


def _notes(tensors: Mapping[str, Any], fit: ResamplingFit | None) -> tuple[str, ...]:
    notes = ["depth images are taken as millimetres, negative where pressed"]
    notes += [] if fit is None else [fit.note]
    if "in_hand_pose" in tensors:
        notes.append(
            "in_hand_pose is left out: its documentation says millimetres, its programs read metres"
        )
    return tuple(notes)
