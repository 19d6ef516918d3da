"""Calibration table of a sensor (photometric stereo look-up from colour to slope), its origin
and quality.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import slope_model
from pipeline.calibration.markers import detect_markers, inpaint_markers, remove_printed_markers
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.core import disk_store
from pipeline.core.arrays import Floats, Image, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import CalibrationError
from pipeline.core.frozen import frozen
from pipeline.sensors.spec import Markers, SensorSpec

SMOOTHING_PX = 1.0  # blur of the colour change, the same in fitting and in use
P90_OVER_STD = 1.645  # of the sizes of normal errors
USUAL_STD = 0.14  # of a ball's size on a real unit without calibration (`benchmarks.real_depth`)
_DEGREES = 4, 2  # of colour and position, of the built-in table
_CODE = (  # modules that the built-in table depends on: part of its cache key
    "pipeline.calibration.calibration_table",
    "pipeline.calibration.slope_model",
    "pipeline.physics.optics",
    "pipeline.physics.optics_kernels",
    "pipeline.sensors.parts",
)
_N_SLOPES = 96  # slope images that the built-in table is fitted to
_N_PIXELS = 400  # pixels taken from each
_COVERED_SHARE = 0.5  # of a touch that must be covered
# of a thumbnail: an instance's light is smooth, and a shifted lens is one of these pixels
_LONGER_SIDE_PX = 160
_SLOPE_MAX = 1.2  # mm/mm: about 50 degrees, the rim of a deep ball press


@frozen
class BallFit:
    """The fit of one press of the ball."""

    index: int  # of the image
    x_px: float  # centre
    y_px: float
    radius_px: float  # of the contact
    residual: float  # rms slope error in contact, mm/mm; NaN = not used
    used: bool


@frozen
class ExpectedError:
    """Relative error of a ball measured with the calibration anywhere in the image: median and
    90th percentile.
    """

    diameter_share: float  # of its diameter
    diameter_p90: float
    depth_share: float  # of its indentation
    depth_p90: float
    n_held_out: int  # validation presses; 0 = predicted only

    @property
    def depth_std(self) -> float:
        """Relative standard deviation of the indentation."""
        return self.depth_p90 / P90_OVER_STD


@frozen
class Calibration:
    """A sensor's mapping from colour change to slope."""

    sensor: str
    rows: int
    cols: int
    pixel_mm: float
    model: SlopeModel
    origin: str  # a sentence for the user
    presses: tuple[BallFit, ...] = ()  # empty = from the sensor's description
    # the presses did not improve on the table of the sensor's description
    uses_built_in: bool = False
    expected_error: ExpectedError | None = None  # None = not measured
    # diameter measured without calibration over the one given; None = unknown
    diameter_ratio: float | None = None
    # of the sensor instance, by `make_thumbnail`; None = unknown
    reference_thumbnail: Image | None = None
    # on any coarse grid: factor of depth by the description; None = 1
    depth_scale_map: Floats | None = None
    # on any coarse grid: parts of the image that the presses cover; None = all
    coverage_map: Mask | None = None

    @property
    def residual(self) -> float:
        """Root mean square of the slope errors of the presses that are used, mm/mm."""
        return float(np.sqrt(np.mean([p.residual**2 for p in self.presses if p.used])))

    @property
    def is_built_in(self) -> bool:
        """Whether the table is that of the sensor's description."""
        return self.uses_built_in or not self.presses

    def compute_depth_scale(self, surface_mm: Floats, corner: tuple[int, int]) -> float:
        """Factor of depth where a surface (rows, cols) whose first pixel is `corner` is deepest."""
        if self.depth_scale_map is None:
            return 1.0
        weight = np.maximum(surface_mm, 0.0).astype(np.float64) ** 2
        total = float(weight.sum())
        scale = self._spread(self.depth_scale_map, corner, surface_mm.shape)
        return float((scale * weight).sum()) / total if total > 0.0 else 1.0

    def covers(self, where: Mask, corner: tuple[int, int]) -> bool:
        """Whether presses cover most of a mask (rows, cols) whose first pixel is `corner`."""
        if self.coverage_map is None or not where.any():
            return True
        covered = self._spread(self.coverage_map.astype(np.float32), corner, where.shape)
        return bool(covered[where].mean() > _COVERED_SHARE)

    def _spread(self, grid: Floats, corner: tuple[int, int], shape: tuple[int, ...]) -> Floats:
        """Values (rows, cols) of a coarse grid over the image in its part of this shape and
        first pixel.
        """
        import cv2

        whole = np.asarray(
            cv2.resize(grid, (self.cols, self.rows), interpolation=cv2.INTER_LINEAR), np.float32
        )
        row, col = corner
        return whole[row : row + shape[0], col : col + shape[1]]


def compute_relative_change(
    image: NDArray[Any],
    reference: NDArray[Any],
    pixel_mm: float,
    *,
    markers: Markers | None = None,
) -> Floats:
    """The smoothed colour change relative to the reference brightness, q of `slope_model`.

    (rows, cols, 3).

    Printed markers of both images are inpainted.
    """
    import cv2

    change = image.astype(np.float32) - reference.astype(np.float32)
    bright = reference.astype(np.float32)
    if markers is not None:
        printed, bright = remove_printed_markers(reference, markers, pixel_mm)
        hidden = printed | detect_markers(image, markers, pixel_mm)
        change = inpaint_markers(change, hidden, markers, pixel_mm)
    change = cv2.GaussianBlur(change, (0, 0), SMOOTHING_PX)
    return np.asarray(change, np.float32) * slope_model.compute_gain(bright)


@derive_once
def make_built_in(sensor: SensorSpec) -> Calibration:
    """The calibration table of the sensor's optical description, cached on disk.

    The forward model is sampled over the whole image and slopes up to 50 degrees, and inverted by
    regression. Raises CalibrationError for a sensor without optics.
    """
    if sensor.optics is None:
        raise CalibrationError(
            f"{sensor.name} has no optics to derive a calibration from; it measures depth itself"
        )

    # The shading of a slope is independent of distance, so variants of a sensor at several depths
    # share the fit.
    model = disk_store.load_or_make(
        SlopeModel,
        (sensor.camera, sensor.optics),
        _CODE,
        lambda: _invert_optics(sensor),
        "calibration_tables",
    )
    return Calibration(
        sensor=sensor.name,
        rows=sensor.camera.rows,
        cols=sensor.camera.cols,
        pixel_mm=sensor.pixel_mm,
        model=model,
        origin="derived from the sensor's optical description",
    )


def _invert_optics(sensor: SensorSpec) -> SlopeModel:
    from pipeline.physics import optics

    rng = np.random.default_rng(0)
    shape = sensor.camera.shape
    plain = optics.render_reference(replace(sensor, markers=None))
    scale = slope_model.compute_gain(plain)
    u, v = slope_model.compute_positions(shape)
    parts: list[tuple[Floats, ...]] = []
    for index in range(_N_SLOPES):
        steep = _SLOPE_MAX * index / (_N_SLOPES - 1)
        angle = rng.uniform(0.0, 2.0 * np.pi, shape).astype(np.float32)
        gx = steep * np.cos(angle)
        gy = steep * np.sin(angle)
        row = rng.integers(0, shape[0], _N_PIXELS)
        col = rng.integers(0, shape[1], _N_PIXELS)
        seen = optics.compute_colour_change(sensor, gx, gy)[row, col]
        # The camera saturates at eight bits.
        seen = np.clip(seen + plain[row, col], 0.0, 255.0) - plain[row, col]
        parts.append(
            (
                seen * scale[row, col],
                u[col],
                v[row],
                np.stack([gx[row, col], gy[row, col]], axis=-1),
            )
        )
    change, u_all, v_all, g = (
        np.concatenate(p).astype(np.float32) for p in zip(*parts, strict=True)
    )
    samples = SlopeSamples(change=change, u=u_all, v=v_all, slopes=g)
    return slope_model.fit(
        samples,
        colour_degree=_DEGREES[0],
        position_degree=_DEGREES[1],
        ridge=1e-7,
        huber=0.1,
    )


def make_thumbnail(reference: Image) -> Image:
    """A reference image (rows, cols, 3), downsampled to the pixels that distinguish sensor
    instances.
    """
    import cv2

    share = _LONGER_SIDE_PX / max(reference.shape[:2])
    if share >= 1.0:
        return freeze(reference.copy())
    rows, cols = (max(1, round(share * n)) for n in reference.shape[:2])
    return freeze(
        np.asarray(cv2.resize(reference, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)
    )


def check_calibration(calibration: Calibration, sensor: str, image: Image) -> None:
    """Raise CalibrationError unless the calibration is of this sensor and image size."""
    if calibration.sensor != sensor:
        raise CalibrationError(
            f"the calibration was made for {calibration.sensor!r}, the frame comes from "
            f"{sensor!r}; calibrate that"
        )
    if image.shape[:2] != (calibration.rows, calibration.cols):
        raise CalibrationError(
            f"the calibration was made for images of {calibration.rows} x {calibration.cols} "
            "pixels, "
            f"the frame has {image.shape[0]} x {image.shape[1]}"
        )
