"""The .npz file of a calibration table."""

import dataclasses
import zipfile
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from pipeline.calibration import slope_model
from pipeline.calibration.calibration_table import BallFit, Calibration, ExpectedError
from pipeline.calibration.slope_model import SlopeModel
from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import CalibrationError, FileProblem
from pipeline.core.files import open_atomic, read_arrays
from pipeline.core.torch_archive import ZIP_ERRORS
from pipeline.core.typed_data import Name, Note, Number, convert

_VERSION = 3
_WHAT = "the calibration"
_REMEDY = "calibrate again"
_MAPS = {  # images of a calibration -> dimensions and type; an empty one stands for None
    "reference_thumbnail": (3, np.uint8),
    "coverage_map": (2, np.bool_),
    "depth_scale_map": (2, np.float32),
}
_ARRAYS = ("coefficients", *_MAPS)  # the other fields are numbers, texts and lists
_MOST_VALUES = 100_000  # of a list
_SCALE_MAX = 10.0
# arrays by which a file is recognised
_TABLE = frozenset(("coefficients", "slope_max"))
_FORCE = "force_scale"
_Side = Annotated[int, Meta(ge=1, le=100_000)]
_Positive = Annotated[float, Meta(gt=0.0, le=1e12)]


class _Content(msgspec.Struct, kw_only=True, frozen=True):
    """The fields of the file; a list of at most one stands for a value that may be unknown."""

    version: Literal[3]
    sensor: Name
    size: tuple[_Side, _Side]  # rows, cols
    pixel_mm: _Positive
    coefficients: Any
    colour_degree: Annotated[int, Meta(ge=1, le=6)]
    position_degree: Annotated[int, Meta(ge=0, le=6)]
    slope_max: _Positive
    origin: Note
    presses: tuple[tuple[Number, float, float, float, float, Number], ...]  # see `_encode_presses`
    uses_built_in: bool
    expected_error: Annotated[
        tuple[Annotated[float, Meta(ge=0.0, le=1e12)], ...], Meta(max_length=5)
    ]
    diameter_ratio: Annotated[tuple[_Positive, ...], Meta(max_length=1)]
    reference_thumbnail: Any
    coverage_map: Any
    depth_scale_map: Any


def is_calibration_file(path: Path) -> bool:
    """Whether a file is a calibration of `tactoscope calibrate`, judged by the arrays in it."""
    arrays = _list_arrays(path)
    return arrays >= _TABLE or _FORCE in arrays


def load_if_present(path: Path) -> Calibration | None:
    """The calibration table in a file.

    None for a force scale alone. Raises FileProblem as `load`.
    """
    arrays = _list_arrays(path)
    return None if _FORCE in arrays and not arrays & _TABLE else load(path)


def _list_arrays(path: Path) -> set[str]:
    """Names of the arrays in an .npz file, empty where it cannot be read."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return set()
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, *ZIP_ERRORS):
        return set()


def save(calibration: Calibration, path: Path | str) -> Path:
    """Write the calibration as .npz and return its place; a failure leaves no half-written file."""
    path = Path(path)
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    model = calibration.model
    error = calibration.expected_error
    maps: dict[str, Any] = {
        name: np.zeros((0,) * n_axes, kind)
        if getattr(calibration, name) is None
        else getattr(calibration, name)
        for name, (n_axes, kind) in _MAPS.items()
    }
    with open_atomic(path, _WHAT, load) as file:
        np.savez_compressed(
            file,
            version=_VERSION,
            sensor=calibration.sensor,
            size=(calibration.rows, calibration.cols),
            pixel_mm=calibration.pixel_mm,
            coefficients=model.coefficients,
            colour_degree=model.colour_degree,
            position_degree=model.position_degree,
            slope_max=model.slope_max,
            origin=calibration.origin,
            presses=_encode_presses(calibration.presses),
            uses_built_in=calibration.uses_built_in,
            expected_error=[] if error is None else dataclasses.astuple(error),
            diameter_ratio=[]
            if calibration.diameter_ratio is None
            else [calibration.diameter_ratio],
            **maps,
        )
    return path


def load(path: Path) -> Calibration:
    """The calibration in a file; raises FileProblem with the field that is missing or damaged."""
    arrays = read_arrays(path, _WHAT)
    if any(array.size > _MOST_VALUES for name, array in arrays.items() if name not in _ARRAYS):
        raise FileProblem(
            f"{_WHAT} holds a list of more than {_MOST_VALUES} values; {_REMEDY}", path
        )
    plain = {name: array if name in _ARRAYS else array.tolist() for name, array in arrays.items()}
    content = convert(plain, _Content, _WHAT, path, remedy=_REMEDY)
    try:
        return _decode(content)
    except (CalibrationError, ValueError) as error:
        raise FileProblem(f"{_WHAT} is damaged ({error}); {_REMEDY}", path) from error


def _decode(content: _Content) -> Calibration:
    table = np.asarray(content.coefficients)
    side = content.position_degree + 1
    shape = (side, side, len(slope_model.list_exponents(content.colour_degree)), 2)
    if table.shape != shape or table.dtype.kind != "f" or not np.isfinite(table).all():
        raise CalibrationError("its coefficients do not fit its degrees or are not finite")
    if len(content.expected_error) not in (0, 5):
        raise CalibrationError("expected_error must be five numbers of 0 or more")
    if any(used and not np.isfinite(place).all() for _, *place, _, used in content.presses):
        raise CalibrationError("a press that is used has no centre or radius")
    diameter, diameter_p90, depth, depth_p90, n_held_out = content.expected_error or (0.0,) * 5
    model = SlopeModel(
        colour_degree=content.colour_degree,
        position_degree=content.position_degree,
        coefficients=freeze(np.ascontiguousarray(table, np.float32)),
        slope_max=content.slope_max,
    )
    rows, cols = content.size
    return Calibration(
        sensor=content.sensor,
        rows=rows,
        cols=cols,
        pixel_mm=content.pixel_mm,
        model=model,
        origin=content.origin,
        uses_built_in=content.uses_built_in,
        presses=tuple(
            BallFit(
                index=int(index),
                x_px=x,
                y_px=y,
                radius_px=radius,
                residual=residual,
                used=bool(used),
            )
            for index, x, y, radius, residual, used in content.presses
        ),
        expected_error=ExpectedError(
            diameter_share=diameter,
            diameter_p90=diameter_p90,
            depth_share=depth,
            depth_p90=depth_p90,
            n_held_out=int(n_held_out),
        )
        if content.expected_error
        else None,
        diameter_ratio=next(iter(content.diameter_ratio), None),
        **{name: _decode_image(getattr(content, name), name) for name in _MAPS},
    )


def _encode_presses(presses: tuple[BallFit, ...]) -> Doubles:
    """Presses (n, 6): index, centre x and y, radius, residual, whether used."""
    rows = [(p.index, p.x_px, p.y_px, p.radius_px, p.residual, p.used) for p in presses]
    return np.array(rows, np.float64).reshape(-1, 6)


def _decode_image(image: NDArray[Any], name: str) -> Any:
    """The array of a field with the dimensions and the type of `_MAPS`; None if it is empty."""
    if image.size == 0:
        return None
    if (image.ndim, image.dtype) != _MAPS[name]:
        raise CalibrationError(f"{name} is {image.dtype} of shape {image.shape}")
    # NaN is neither
    if name == "depth_scale_map" and not (image.min() > 0.0 and image.max() <= _SCALE_MAX):
        raise CalibrationError(f"depth_scale_map must lie within 0 and {_SCALE_MAX:g}")
    return freeze(np.ascontiguousarray(image))
