"""The .npz file of a calibration table."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.base.files import open_atomic, read_arrays
from pipeline.calibration import slope_model
from pipeline.calibration.calibration_table import BallFit, Calibration, ExpectedError
from pipeline.calibration.slope_model import SlopeModel

_VERSION = 2
_DEGREE_MAX = 6


def is_calibration_file(path: Path) -> bool:
    """Whether a file is a calibration of `tactoscope calibrate`, judged by the arrays in it."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return {"coefficients.npy", "slope_max.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def save(calibration: Calibration, path: Path) -> None:
    """Write the calibration as .npz; a failure leaves no half-written file."""
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    model, error, share = calibration.model, calibration.expected_error, calibration.median_pressure_share
    thumbnail, coverage = calibration.reference_thumbnail, calibration.coverage_map
    with open_atomic(path, "the calibration") as file:
        np.savez_compressed(
            file, version=_VERSION, sensor=calibration.sensor, size=(calibration.rows, calibration.cols),
            pixel_mm=calibration.pixel_mm, coefficients=model.coefficients, colour_degree=model.colour_degree,
            position_degree=model.position_degree, slope_max=model.slope_max, residual=calibration.residual,
            origin=calibration.origin, presses=_encode_presses(calibration.presses),
            uses_built_in=calibration.uses_built_in,
            expected_error=[] if error is None else [error.diameter_share, error.depth_share, error.n_held_out],
            diameter_ratio=[] if calibration.diameter_ratio is None else [calibration.diameter_ratio],
            reference_thumbnail=np.zeros((0, 0, 3), np.uint8) if thumbnail is None else thumbnail,
            coverage_map=np.zeros((0, 0), np.bool_) if coverage is None else coverage,
            median_pressure_share=[] if share is None else [share],
        )  # fmt: skip


def load(path: Path) -> Calibration:
    """The calibration in a file; raises FileProblem with the field that is missing or damaged."""
    fields = read_arrays(path, "the calibration")
    try:
        if any(array.dtype.kind not in "biufU" for array in fields.values()):
            raise CalibrationError("it holds arrays that are neither numbers nor texts")
        return _decode(fields)
    except KeyError as error:
        field = str(error.args[0])
        raise FileProblem(f"the calibration lacks {field!r}; calibrate again", path, field=field) from error
    except (CalibrationError, ValueError, TypeError, ArithmeticError) as error:
        raise FileProblem(f"the calibration is damaged ({error}); calibrate again", path) from error


def _decode(fields: dict[str, NDArray[Any]]) -> Calibration:
    if int(cast("int", fields["version"])) != _VERSION:
        raise CalibrationError(f"version {fields['version']} is not {_VERSION}")
    colour_degree, position_degree = (int(cast("int", fields[k])) for k in ("colour_degree", "position_degree"))
    if not (1 <= colour_degree <= _DEGREE_MAX and 0 <= position_degree <= _DEGREE_MAX):
        raise CalibrationError("its degrees are out of range")
    table = np.ascontiguousarray(fields["coefficients"], np.float32)
    side = position_degree + 1
    if table.shape != (side, side, len(slope_model.list_exponents(colour_degree)), 2) or not np.isfinite(table).all():
        raise CalibrationError("its coefficients do not fit its degrees or are not finite")
    numbers = {k: float(cast("float", fields[k])) for k in ("pixel_mm", "slope_max", "residual")}
    if not all(np.isfinite(v) for v in numbers.values()) or min(numbers["pixel_mm"], numbers["slope_max"]) <= 0:
        raise CalibrationError("pixel_mm and slope_max must be positive")
    rows, cols = (int(cast("int", n)) for n in fields["size"])
    model = SlopeModel(
        colour_degree=colour_degree, position_degree=position_degree, coefficients=freeze(table),
        slope_max=numbers["slope_max"],
    )  # fmt: skip
    return Calibration(
        sensor=str(fields["sensor"]), rows=rows, cols=cols, pixel_mm=numbers["pixel_mm"], model=model,
        residual=numbers["residual"], origin=str(fields["origin"]), presses=_decode_presses(fields["presses"]),
        uses_built_in=bool(fields["uses_built_in"]), expected_error=_decode_error(fields["expected_error"]),
        diameter_ratio=next(iter(fields["diameter_ratio"].tolist()), None),
        reference_thumbnail=_decode_image(fields, "reference_thumbnail", 3, np.uint8),
        coverage_map=_decode_image(fields, "coverage_map", 2, np.bool_),
        median_pressure_share=_decode_share(fields["median_pressure_share"]),
    )  # fmt: skip


def _encode_presses(presses: tuple[BallFit, ...]) -> Doubles:
    """Presses (n, 6): index, centre x and y, radius, residual, whether used."""
    rows = [(p.index, p.x_px, p.y_px, p.radius_px, p.residual, p.used) for p in presses]
    return np.array(rows, np.float64).reshape(-1, 6)


def _decode_presses(table: NDArray[Any]) -> tuple[BallFit, ...]:
    if table.ndim != 2 or table.shape[1] != 6:
        raise CalibrationError(f"its table of presses has shape {table.shape}")
    return tuple(
        BallFit(index=int(i), x_px=float(x), y_px=float(y), radius_px=float(r), residual=float(e), used=bool(used))
        for i, x, y, r, e, used in table
    )


def _decode_error(row: NDArray[Any]) -> ExpectedError | None:
    if row.shape == (0,):
        return None
    if row.shape != (3,) or not np.isfinite(row).all() or row.min() < 0:
        raise CalibrationError("expected_error must be three numbers of 0 or more")
    return ExpectedError(diameter_share=float(row[0]), depth_share=float(row[1]), n_held_out=int(row[2]))


def _decode_image(fields: dict[str, NDArray[Any]], name: str, ndim: int, kind: type[np.generic]) -> NDArray[Any] | None:
    """The array of a field with that many dimensions and that type; None if it is empty."""
    image = fields[name]
    if image.size == 0:
        return None
    if image.ndim != ndim or image.dtype != kind:
        raise CalibrationError(f"{name} is {image.dtype} of shape {image.shape}")
    return freeze(np.ascontiguousarray(image))


def _decode_share(share: NDArray[Any]) -> float | None:
    value = next(iter(share.tolist()), None)
    if value is not None and not 0.0 < value <= 1.0:
        raise CalibrationError(f"median_pressure_share must lie within 0 and 1, got {value:g}")
    return value
