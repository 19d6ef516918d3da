"""The file of a look-up."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Image, Mask, freeze
from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.base.files import read_arrays, whole_file
from pipeline.calibration import slope_model
from pipeline.calibration.calibration_table import BallFit, Calibration, ExpectedError
from pipeline.calibration.slope_model import SlopeModel

_VERSION = 1


def is_calibration_file(path: Path) -> bool:
    """Whether a file is a look-up made by `tactoscope calibrate`, told from other archives by what it holds."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return {"coefficients.npy", "slope_max.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def save(calibration: Calibration, path: Path) -> None:
    """Write the look-up as .npz, beside its place first, so that no half-written file is ever found there."""
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    model = calibration.model
    with whole_file(path, "the calibration") as file:
        np.savez_compressed(
            file, version=_VERSION, sensor=calibration.sensor, size=(calibration.rows, calibration.cols),
            pixel_mm=calibration.pixel_mm, coefficients=model.coefficients, colour_degree=model.colour_degree,
            position_degree=model.position_degree, slope_max=model.slope_max, residual=calibration.residual,
            origin=calibration.origin, presses=_table_of(calibration.presses),
            uses_built_in=calibration.uses_built_in, expected=_row_of(calibration.expected_error),
            diameter_ratio=[] if calibration.diameter_ratio is None else [calibration.diameter_ratio],
            still=np.zeros((0, 0, 3), np.uint8) if calibration.reference_thumbnail is None else calibration.reference_thumbnail,
            told=np.zeros((0, 0), np.bool_) if calibration.coverage_map is None else calibration.coverage_map,
            median_pressure_share=[] if calibration.median_pressure_share is None else [calibration.median_pressure_share],
        )  # fmt: skip


def load(path: Path) -> Calibration:
    """Read a look-up back; raises FileProblem naming the field that is missing or damaged."""
    fields = read_arrays(path, "the calibration")
    try:
        return _from_fields(fields)
    except KeyError as error:
        field = str(error.args[0])
        raise FileProblem(f"the calibration lacks {field!r}; calibrate again", path, field=field) from error
    except (CalibrationError, ValueError, TypeError) as error:
        raise FileProblem(f"the calibration is damaged ({error}); calibrate again", path) from error


def _from_fields(fields: dict[str, NDArray[Any]]) -> Calibration:
    if int(cast("int", fields["version"])) != _VERSION:
        raise CalibrationError(f"version {fields['version']} is not {_VERSION}")
    colour_degree, position_degree = (int(cast("int", fields[k])) for k in ("colour_degree", "position_degree"))
    if not (1 <= colour_degree <= 6 and 0 <= position_degree <= 6):
        raise CalibrationError("its degrees are out of range")
    table = np.ascontiguousarray(fields["coefficients"], np.float32)
    side = position_degree + 1
    if table.shape != (side, side, len(slope_model.list_exponents(colour_degree)), 2) or not np.isfinite(table).all():
        raise CalibrationError("its coefficients do not fit its degrees or are not finite")
    numbers = {k: float(cast("float", fields[k])) for k in ("pixel_mm", "slope_max", "residual")}
    if not all(np.isfinite(v) for v in numbers.values()) or min(numbers["pixel_mm"], numbers["slope_max"]) <= 0:
        raise CalibrationError("pixel_mm and slope_max must be positive")
    rows, cols = (int(cast("int", n)) for n in fields["size"])
    return Calibration(
        sensor=str(fields["sensor"]), rows=rows, cols=cols, pixel_mm=numbers["pixel_mm"],
        model=SlopeModel(colour_degree=colour_degree, position_degree=position_degree, coefficients=freeze(table),
                         slope_max=numbers["slope_max"]),
        residual=numbers["residual"], origin=str(fields["origin"]), presses=_presses_of(fields["presses"]),
        uses_built_in=bool(fields.get("kept_built_in", False)),  # this and all below older files lack
        expected_error=_expected_of(fields.get("expected", np.zeros(0))), reference_thumbnail=_still_of(fields.get("still")),
        diameter_ratio=next(iter(fields.get("read_as", np.zeros(0)).tolist()), None), coverage_map=_told_of(fields.get("told")),
        median_pressure_share=_share_of(fields.get("usual_share", np.zeros(0))),
    )  # fmt: skip


def _table_of(presses: tuple[BallFit, ...]) -> Doubles:
    rows = [(p.index, p.x_px, p.y_px, p.radius_px, p.residual, p.used) for p in presses]
    return np.array(rows, np.float64).reshape(-1, 6)


def _presses_of(table: NDArray[Any]) -> tuple[BallFit, ...]:
    if table.ndim != 2 or table.shape[1] != 6:
        raise CalibrationError(f"its table of presses has shape {table.shape}")
    return tuple(
        BallFit(index=int(i), x_px=float(x), y_px=float(y), radius_px=float(r), residual=float(e), used=bool(used))
        for i, x, y, r, e, used in table
    )


def _row_of(error: ExpectedError | None) -> Doubles:
    return np.array([] if error is None else [error.diameter_share, error.depth_share, error.n_held_out], np.float64)


def _expected_of(row: NDArray[Any]) -> ExpectedError | None:
    if row.shape == (0,):
        return None
    if row.shape != (3,) or not np.isfinite(row).all() or row.min() < 0:
        raise CalibrationError("its expected error must be three numbers of 0 or more")
    return ExpectedError(diameter_share=float(row[0]), depth_share=float(row[1]), n_held_out=int(row[2]))


def _still_of(picture: NDArray[Any] | None) -> Image | None:
    if picture is None or picture.size == 0:
        return None
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise CalibrationError(f"its untouched picture is {picture.dtype} of shape {picture.shape}")
    return freeze(np.ascontiguousarray(picture))


def _told_of(places: NDArray[Any] | None) -> Mask | None:
    if places is None or places.size == 0:
        return None
    if places.ndim != 2 or places.dtype != np.bool_:
        raise CalibrationError(f"its places that presses tell are {places.dtype} of shape {places.shape}")
    return freeze(np.ascontiguousarray(places))


def _share_of(share: NDArray[Any]) -> float | None:
    found = next(iter(share.tolist()), None)
    if found is not None and not 0.0 < found <= 1.0:
        raise CalibrationError(f"its share of the usual pressure must lie within 0 and 1, got {found:g}")
    return found
