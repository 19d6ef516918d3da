"""The colour-to-slope look-up of one sensor: where it came from, and how good it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Image, Mask
from pipeline.base.errors import CalibrationError
from pipeline.base.memo import Memo
from pipeline.calibration import slope_model
from pipeline.calibration.markers import detect_markers, inpaint_markers, remove_printed_markers
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.engine import disk_store
from pipeline.engine.digests import compute_cached_digest
from pipeline.sensors.spec import Markers, SensorSpec

SMOOTHING_PX = 1.0  # of the colour change, the same when the look-up is fitted and when it is used
_DEGREES = 4, 2  # of colour and of position, of the built-in look-up
_CODE = (  # what it comes from
    "pipeline.calibration.calibration_table", "pipeline.calibration.slope_model", "pipeline.physics.optics",
    "pipeline.physics.optics_kernels", "pipeline.sensors.reference_light",
)  # fmt: skip
_N_SLOPES = 96  # slope images that the built-in look-up is fitted to
_N_PIXELS = 400  # pixels taken from each
_MOST = 0.5  # of a touch
_STEEPEST = 1.2  # mm/mm: about 50 degrees, the rim of a deep ball press


@dataclass(frozen=True, slots=True, kw_only=True)
class BallFit:
    """What the calibration made of one press of the ball."""

    index: int  # of the picture among those given
    x_px: float  # centre
    y_px: float
    radius_px: float  # of the contact
    residual: float  # rms slope error inside the contact, mm/mm; NaN = not used
    used: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedError:
    """How wrong a ball will be that is measured with the look-up anywhere in the picture: the median of many."""

    diameter_share: float  # of its diameter
    depth_share: float  # of how far it is pushed in
    n_held_out: int  # presses that this was checked on; 0 = foreseen only


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """What turns this sensor's colours into slopes."""

    sensor: str
    rows: int
    cols: int
    pixel_mm: float
    model: SlopeModel
    residual: float  # rms slope error of the samples it was fitted to, mm/mm
    origin: str  # a sentence for the user
    presses: tuple[BallFit, ...] = ()  # empty = from the sensor's optical description
    uses_built_in: bool = False  # the presses did not better the look-up from the sensor's description
    expected_error: ExpectedError | None = None  # None = nobody has measured it
    diameter_ratio: float | None = (
        None  # the ball's diameter that is read without calibration over the one given; None = unknown
    )
    reference_thumbnail: Image | None = None  # the unit's untouched picture, `units.small`; None = nobody has kept it
    coverage_map: Mask | None = (
        None  # places of the picture, on any coarse grid, where presses tell the light; None = all
    )
    median_pressure_share: float | None = (
        None  # of the usual pressure that ends a contact on this gel (`contact`); None = usual
    )

    @property
    def is_built_in(self) -> bool:
        """Whether this is what the sensor's description implies, whatever was pressed."""
        return self.uses_built_in or not self.presses

    def covers(self, where: Mask, corner: tuple[int, int]) -> bool:
        """Whether presses tell the light of most of `where` (rows, cols), whose first pixel is `corner`."""
        import cv2

        if self.coverage_map is None or not where.any():
            return True
        whole = cv2.resize(self.coverage_map.astype(np.float32), (self.cols, self.rows), interpolation=cv2.INTER_LINEAR)
        row, col = corner
        return bool(whole[row : row + where.shape[0], col : col + where.shape[1]][where].mean() > _MOST)


def compute_slopes(
    calibration: Calibration,
    image: Image,
    reference: NDArray[Any],
    where: Mask,
    corner: tuple[int, int] = (0, 0),
    *,
    markers: Markers | None = None,
    smoothing_px: float = SMOOTHING_PX,
) -> tuple[Floats, Floats]:
    """(gx, gy) of the indentation, mm/mm, x right and y down: (rows, cols) float32, zero outside `where`.

    The pictures are the part of the calibrated one whose first pixel is `corner`.
    """
    change = compute_relative_change(image, reference, calibration.pixel_mm, markers=markers, smoothing_px=smoothing_px)
    u, v = slope_model.compute_positions((calibration.rows, calibration.cols))
    (row, col), (rows, cols) = corner, where.shape
    return slope_model.evaluate(calibration.model, change, u[col : col + cols], v[row : row + rows], where)


def compute_relative_change(
    image: NDArray[Any],
    reference: NDArray[Any],
    pixel_mm: float,
    *,
    markers: Markers | None = None,
    smoothing_px: float = SMOOTHING_PX,
) -> Floats:
    """The smoothed change of colour relative to the untouched brightness, q of `slope_model`; (rows, cols, 3).

    Printed markers, where they are now and where they were, are filled in from around them.
    """
    import cv2

    change = image.astype(np.float32) - reference.astype(np.float32)
    bright = reference.astype(np.float32)
    if markers is not None:
        printed, bright = remove_printed_markers(reference, markers, pixel_mm)
        hidden = printed | detect_markers(image, markers, pixel_mm)
        change = inpaint_markers(change, hidden, markers, pixel_mm)
    if smoothing_px > 0:
        change = cv2.GaussianBlur(change, (0, 0), smoothing_px)
    return np.asarray(change, np.float32) * slope_model.compute_gain(bright)


_built_in_cache: Memo[str, Calibration] = Memo(16)  # simulated variations of a sensor are many


def make_built_in(sensor: SensorSpec) -> Calibration:
    """The look-up that the sensor's optical description implies, made once per sensor.

    The forward model is sampled over the whole image and all slopes up to 50 degrees, and inverted by regression.
    Raises CalibrationError for a sensor without optics.
    """
    if sensor.optics is None:
        raise CalibrationError(f"{sensor.name} has no optics to derive a look-up from; it measures depth itself")

    def make() -> Calibration:
        # Light falls on slopes alike at any distance, so that units of one sensor at several depths share the fit.
        fitted = disk_store.load_or_make(
            _Fitted, (sensor.camera, sensor.optics), _CODE, lambda: _invert_optics(sensor), "look_ups"
        )
        model = SlopeModel(colour_degree=_DEGREES[0], position_degree=_DEGREES[1],
                           coefficients=fitted.coefficients, slope_max=fitted.slope_max)  # fmt: skip
        return Calibration(
            sensor=sensor.name, rows=sensor.camera.rows, cols=sensor.camera.cols, pixel_mm=sensor.pixel_mm, model=model,
            residual=fitted.residual, origin="derived from the sensor's optical description",
        )  # fmt: skip

    return _built_in_cache.get_or_make(compute_cached_digest(sensor), make)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fitted:
    """What the regression finds."""

    coefficients: Floats  # of a `SlopeModel` of the built-in degrees
    slope_max: float
    residual: float


def _invert_optics(sensor: SensorSpec) -> _Fitted:
    from pipeline.physics import optics

    rng = np.random.default_rng(0)
    shape = sensor.camera.shape
    plain = optics.render_reference(_without_markers(sensor))
    scale = slope_model.compute_gain(plain)
    u, v = slope_model.compute_positions(shape)
    parts: list[tuple[Floats, ...]] = []
    for index in range(_N_SLOPES):
        steep = _STEEPEST * index / (_N_SLOPES - 1)
        angle = rng.uniform(0.0, 2.0 * np.pi, shape).astype(np.float32)
        gx, gy = steep * np.cos(angle), steep * np.sin(angle)
        row, col = rng.integers(0, shape[0], _N_PIXELS), rng.integers(0, shape[1], _N_PIXELS)
        seen = optics.compute_colour_change(sensor, gx, gy)[row, col]
        # Eight bits end somewhere: what the camera cannot record must not be expected here.
        seen = np.clip(seen + plain[row, col], 0.0, 255.0) - plain[row, col]
        parts.append((seen * scale[row, col], u[col], v[row], np.stack([gx[row, col], gy[row, col]], axis=-1)))
    change, u_all, v_all, g = (np.concatenate(p).astype(np.float32) for p in zip(*parts, strict=True))
    samples = SlopeSamples(change=change, u=u_all, v=v_all, slopes=g)
    model = slope_model.fit(
        samples, np.ones(len(g), np.float32), colour_degree=_DEGREES[0], position_degree=_DEGREES[1], ridge=1e-7,
        huber=0.1,
    )  # fmt: skip
    rms = float(np.sqrt(np.mean((slope_model.predict(model, samples) - g) ** 2)))
    return _Fitted(coefficients=model.coefficients, slope_max=model.slope_max, residual=rms)


def _without_markers(sensor: SensorSpec) -> SensorSpec:
    return sensor if sensor.markers is None else replace(sensor, markers=None)


def check_calibration(calibration: Calibration, sensor: str, image: Image) -> None:
    """Raise CalibrationError unless the look-up was made for this sensor and image size."""
    if calibration.sensor != sensor:
        raise CalibrationError(
            f"the calibration was made for {calibration.sensor!r}, the frame comes from {sensor!r}; calibrate that one"
        )
    if image.shape[:2] != (calibration.rows, calibration.cols):
        raise CalibrationError(
            f"the calibration was made for pictures of {calibration.rows} x {calibration.cols} pixels, "
            f"the frame has {image.shape[0]} x {image.shape[1]}"
        )
