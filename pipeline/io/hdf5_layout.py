"""Layout of a tactoscope recording in an HDF5 file, for the writer and the reader.

    /                        format, format_version, notes
    /streams/<name>          sensor, order
        frames               (n, rows, cols, 3) uint8 "rgb", or (n, rows, cols) depth "mm"; one
                             chunk per frame
        references           (m, ...) the distinct reference images
        reference_index      (n,) row of `references`, -1 = none
        timestamps           (n,) "s", NaN = not known
        camera_matrix        (3, 3) "px", only where the recording has its own intrinsics
        truth/known          (n,) bits: 1 indentation, 2 contact, 4 pose, 8 force
        truth/indentation    (n, rows, cols) "mm"
        truth/contact        (n, rows, cols) 0 or 1
        truth/sensor_from_object  (n, 4, 4) "mm"
        truth/force          (n, 3) "N" on the sensor: right, down, away from the camera
    /object                  name; vertices (v, 3) "mm", triangles (t, 3)
        symmetry/rotations   (n, 3, 3) rotations about the object's origin that map it onto itself,
                             the identity first
        symmetry/axis        (3,) only where every rotation about it does so; no group `symmetry` =
                             not known
    /pairings/<k>            (4, 4) target_from_source "mm"; source, target
    /rollout                 only in rollouts of tasks: `pipeline/lab/tasks/rollout_file.py`

Every dataset has the attribute `unit` and a Fletcher-32 checksum per chunk; images are compressed.
Lengths may be stored as integers: value = integer * `step_mm`, and `nan_code` is "no value".
`coding` = "row differences" means that each row but the first is its difference from the row above,
modulo the integer's range; `numpy.cumsum` along rows in the same type restores it. This lossless
coding makes noisy images a third smaller.
"""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats
from pipeline.core.errors import FileProblem, ShapeError

FORMAT = "tactoscope recording"
VERSION = 1
# reserved at the front, so that a truncated file keeps its table of contents
METADATA_BYTES = 1 << 16

Coding = Literal["plain", "row differences"]

UNITS: Mapping[str, str] = {
    "reference_index": "1",
    "timestamps": "s",
    "camera_matrix": "px",
    "truth/known": "1",
    "truth/indentation": "mm",
    "truth/contact": "1",
    "truth/sensor_from_object": "mm",
    "truth/force": "N",
    "vertices": "mm",
    "triangles": "1",
    "pairing": "mm",
    "symmetry/rotations": "1",
    "symmetry/axis": "1",
}


class TruthField(NamedTuple):
    """Storage of one field of `Truth` in a stream."""

    field: str
    key: str
    bit: int  # in truth/known
    dtype: type  # of values in memory
    shape: tuple[int, ...] | None  # of one frame; None = the image's


TRUTH_FIELDS = (
    TruthField("indentation_mm", "truth/indentation", 1, np.float32, None),
    TruthField("contact", "truth/contact", 2, np.bool_, None),
    TruthField("sensor_from_object", "truth/sensor_from_object", 4, np.float64, (4, 4)),
    TruthField("force_n", "truth/force", 8, np.float64, (3,)),
)

MAX_STEP_MM = 10.0  # largest step of stored lengths, a thousand times that of a depth camera
# Steps of int16 lengths: 0.1 um covers +-3.2 mm of a gel; 1 um covers +-32 mm of a bubble, whose
# noise is 0.4 mm.
GEL_STEP_MM = 1e-4
BUBBLE_STEP_MM = 1e-3


def require_unit(dataset: Any, want: str, path: Path) -> Any:
    """`dataset`, whose attribute `unit` must be `want`; raises FileProblem."""
    key = str(dataset.name).lstrip("/")
    unit = dataset.attrs.get("unit")
    if unit is None:
        raise FileProblem(f"{key} has no unit, want {want!r}", path, field=key)
    if unit != want:
        raise FileProblem(f"{key} is given in {unit!r}, want {want!r}", path, field=key)
    return dataset


def parse_file_size(head: bytes) -> int:
    """The size in bytes of a file with this head: bytes 28 to 35 of superblocks 2 and 3, which this
    format has.

    Raises ValueError for another superblock, struct.error for a shorter head.
    """
    n_bytes: int = struct.unpack_from("<Q", head, 28)[0]
    if head[8] not in (2, 3):
        raise ValueError(f"unexpected superblock {head[8]}")
    return n_bytes


def truncate_to_size(file: BinaryIO) -> None:
    """Cut off the reserved space after the end of the recording in `file`."""
    file.seek(0)
    file.truncate(parse_file_size(file.read(64)))


def encode_frame(values: NDArray[Any], dataset: Any, what: str) -> NDArray[Any]:
    """One frame of `values` as `dataset` stores it.

    Raises ShapeError for a length beyond its integers.
    """
    if "step_mm" in dataset.attrs:
        limits = np.iinfo(dataset.dtype)
        nan_code = int(dataset.attrs["nan_code"])
        counts = np.rint(np.asarray(values, np.float64) / float(dataset.attrs["step_mm"]))
        gaps = np.isnan(counts)
        low = limits.min + (nan_code == limits.min)
        high = limits.max - (nan_code == limits.max)
        if ((counts < low) | (counts > high)).any():
            raise ShapeError(
                f"{what} holds {float(np.nanmax(np.abs(values))):g} mm, but steps of "
                f"{dataset.attrs['step_mm']:g} mm reach from {low * dataset.attrs['step_mm']:g} "
                f"to {high * dataset.attrs['step_mm']:g} mm"
            )
        values = np.where(gaps, nan_code, counts).astype(dataset.dtype)
    if dataset.attrs.get("coding") == "row differences":
        values = np.concatenate([values[:1], values[1:] - values[:-1]])
    return values


def decode_frame(stored: NDArray[Any], dataset: Any) -> NDArray[Any]:
    """The values of one stored frame; inverse of `encode_frame`."""
    if dataset.attrs.get("coding") == "row differences":
        stored = np.cumsum(stored, axis=0, dtype=stored.dtype)
    if "step_mm" not in dataset.attrs:
        return stored
    lengths: Floats = (stored * float(dataset.attrs["step_mm"])).astype(np.float32)
    lengths[stored == dataset.attrs["nan_code"]] = np.nan
    return lengths
