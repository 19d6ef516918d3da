"""The coarse, linear light of a sensor instance: colour change of blocks of pixels by a dent of the
gel.

    dI_c(x) = a_c(x) . grad h(x),   h = sum_k p_k g(x - x_k),   p_k >= 0

a_c is the described light, turned and scaled by 36 numbers (for each channel four, linear over the
image). g is the response of the bonded elastic layer to a small blob of pressure, so that the
height is absolute: the gel is at rest far from all pressure. The 36 numbers are fitted once to a
few touches of a recording, in turn with their pressures, without any truth: a dent's colours
integrate to a surface only in the right light.
"""

import numpy as np

from pipeline.calibration.markers import detect_markers, remove_printed_markers
from pipeline.calibration.slope_model import compute_positions
from pipeline.core.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.physics import gel as gel_layer
from pipeline.physics import optics
from pipeline.sensors.parts import Gel, Markers
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import CHANGE, REST


@frozen
class DriftPrior:
    """Drift of the light and the camera as columns, and how likely it is."""

    columns: Floats  # (n, 14) grey by gain, offset and ramp of each colour, and the shift
    precision: Doubles  # (14, 14)
    curvature: Doubles  # (14, 14) columns^T columns
    projection: Doubles  # (14, 14) the most likely drift by columns^T change


@frozen
class DentBasis:
    """What one unit of pressure at each of m knots does to the gel, at the centres of the
    blocks.
    """

    slopes: Floats  # (rows, cols, 2, m) mm/mm, right and down
    heights: Floats  # (rows, cols, m) mm
    block_mm: float  # width of a block
    knot_mm: float  # between two knots
    loads: Floats  # (rows, cols, m) pressure over that in a blob's middle


def compute_block_px(shape: tuple[int, ...]) -> int:
    """Width of a block in pixels for an image (rows, cols)."""
    return max(1, round(max(shape[:2]) / CHANGE.blocks_along))


def compute_block_means(picture: Image | Floats, block: int) -> Floats:
    """Mean of every whole block (rows // block, cols // block, ...).

    The last few pixels are dropped.
    """
    import cv2

    rows, cols = (n // block for n in picture.shape[:2])
    whole = np.ascontiguousarray(picture[: rows * block, : cols * block])
    # Integer sums over the rows of a block first take half the time.
    kind = np.uint16 if picture.dtype == np.uint8 and block <= 256 else np.float32
    tall = np.add.reduce(whole.reshape(rows, block, -1), axis=1, dtype=kind).astype(np.float32)
    wide = cv2.resize(
        tall.reshape(rows, cols * block, -1), (cols, rows), interpolation=cv2.INTER_AREA
    )
    return np.asarray(wide, np.float32).reshape(rows, cols, *picture.shape[2:]) / np.float32(block)


def compute_block_change(
    image: Image,
    reference: Image,
    markers: Markers | None,
    pixel_mm: float,
    detected: Mask | None = None,
) -> Floats:
    """Mean change (rows, cols, 3) of each block in grey levels.

    Without markers, 0 where they hide nearly all.

    `detected` (rows, cols), what markers hide of the image, is computed where it is None.
    """
    block = compute_block_px(image.shape)
    if markers is None:
        return compute_block_means(image, block) - compute_block_means(reference, block)
    detected = detect_markers(image, markers, pixel_mm) if detected is None else detected
    hidden = detected | _detect_reference_markers(reference, markers, pixel_mm)
    seen = (~hidden).astype(np.float32)
    share = compute_block_means(seen, block)[..., None]
    change = compute_block_means((image.astype(np.float32) - reference) * seen[..., None], block)
    return np.where(
        share > CHANGE.unmarked_min, change / np.maximum(share, CHANGE.unmarked_min), 0.0
    ).astype(np.float32)


@derive_once
def _detect_reference_markers(reference: Image, markers: Markers, pixel_mm: float) -> Mask:
    return freeze(detect_markers(reference, markers, pixel_mm))


@derive_once
def describe_light(source: SensorSpec) -> Floats:
    """Colour change (rows, cols, 3, 2) of each block, in grey levels by a slope of 1 to the
    right and down.
    """
    level = np.zeros(source.camera.shape, np.float32)
    step = level + np.float32(REST.slope_step)
    block = compute_block_px(source.camera.shape)
    rates = [
        compute_block_means(
            optics.compute_colour_change(source, *up) - optics.compute_colour_change(source, *down),
            block,
        )
        for up, down in (((step, level), (-step, level)), ((level, step), (level, -step)))
    ]
    return freeze(np.stack(rates, -1) / np.float32(2 * REST.slope_step))


def make_dent_basis(source: SensorSpec, pixel_mm: float) -> DentBasis:
    """The dents of a sensor's gel, cached."""
    assert source.gel is not None
    return _make_dent_basis(source.camera, source.gel, pixel_mm)


@derive_once
def _make_dent_basis(camera: Camera, gel: Gel, pixel_mm: float) -> DentBasis:
    block = compute_block_px(camera.shape)
    rows, cols = (n // block for n in camera.shape)
    block_mm = block * pixel_mm
    knot_mm = max(camera.shape) * pixel_mm / CHANGE.knots_along
    y_mm, x_mm = (_center(n) * block_mm for n in (rows, cols))
    knots_y, knots_x = (
        _center(int(np.ceil(n * block_mm / knot_mm)) + 2) * knot_mm for n in (rows, cols)
    )
    radius_mm, height, slope = _compute_blob_response(gel, CHANGE.blob_share * knot_mm, block_mm)
    dx = x_mm[None, :, None] - np.tile(knots_x, len(knots_y))
    dy = y_mm[:, None, None] - np.repeat(knots_y, len(knots_x))
    away = np.hypot(dx, dy)
    outward = np.interp(away, radius_mm, slope, right=0.0) / np.maximum(away, 1e-9)
    return DentBasis(
        slopes=freeze(np.stack([outward * dx, outward * dy], 2).astype(np.float32)),
        heights=freeze(np.interp(away, radius_mm, height, right=0.0).astype(np.float32)),
        block_mm=block_mm,
        knot_mm=knot_mm,
        loads=freeze(np.exp(-0.5 * (away / (CHANGE.blob_share * knot_mm)) ** 2).astype(np.float32)),
    )


def _center(n: int) -> Doubles:
    return np.asarray(np.arange(n) - (n - 1) / 2, np.float64)


def _compute_blob_response(
    gel: Gel, width_mm: float, block_mm: float
) -> tuple[Doubles, Doubles, Doubles]:
    """(radius in mm, height, slope by the radius) of the gel around a blob of pressure, averaged
    over blocks.
    """
    n = 512
    step_mm = width_mm / 5
    waves = 2 * np.pi * np.fft.fftfreq(n, step_mm)
    q2 = waves[:, None] ** 2 + waves[None, : n // 2 + 1] ** 2
    blob = np.exp(-q2 * (width_mm**2 + block_mm**2 / 12) / 2)
    height = np.fft.irfft2(gel_layer.compute_symbol(gel, step_mm, (n, n)) * blob, s=(n, n))[
        0, : n // 2
    ]
    height /= height[0]
    return np.arange(n // 2, dtype=np.float64) * step_mm, height, np.gradient(height, step_mm)


def make_dent_columns(light: Floats, basis: DentBasis) -> Floats:
    """The change (n, m) of all blocks and colours by each pressure."""
    colours = (
        light[..., 0, None] * basis.slopes[:, :, None, 0]
        + light[..., 1, None] * basis.slopes[:, :, None, 1]
    )
    return freeze(np.ascontiguousarray(colours.reshape(-1, basis.slopes.shape[-1]), np.float32))


def make_drift_prior(reference: Image, source: SensorSpec, pixel_mm: float) -> DriftPrior:
    """The drift of a reference image (rows, cols, 3)."""
    import cv2

    markers = source.markers
    still = reference.astype(np.float32)
    if markers is not None:
        still = remove_printed_markers(reference, markers, pixel_mm)[1]
    block = compute_block_px(reference.shape)
    by_x, by_y = (0.5 * cv2.Sobel(still, cv2.CV_32F, *axis, ksize=1) for axis in ((1, 0), (0, 1)))
    mean, by_x, by_y = (
        compute_block_means(np.asarray(a, np.float32), block) for a in (still, by_x, by_y)
    )
    rows, cols = mean.shape[:2]
    x, y = np.meshgrid(*compute_positions((rows, cols)))
    columns = np.zeros((rows, cols, 3, 14), np.float32)
    for colour in range(3):
        columns[:, :, colour, 4 * colour : 4 * colour + 4] = np.stack(
            [mean[..., colour], np.ones_like(x), x, y], -1
        )
    columns[..., 12] = -by_x
    columns[..., 13] = -by_y
    stds = np.array([CHANGE.gain_std, CHANGE.offset_std, CHANGE.offset_std, CHANGE.offset_std])
    covariance = np.diag(np.full(14, CHANGE.shift_std**2))
    covariance[:12, :12] = np.kron(correlate_colours(CHANGE.common_share), np.diag(stds**2))
    precision = np.linalg.inv(covariance)
    columns = columns.reshape(-1, 14)
    curvature = columns.astype(np.float64).T @ columns
    return DriftPrior(
        columns=freeze(columns),
        precision=freeze(precision),
        curvature=freeze(curvature),
        projection=freeze(_invert(CHANGE.noise_grey**2 * precision + curvature)),
    )


def fit_dent(
    of_dent: Floats,
    pull: Floats,
    drift_cost: float,
    drift: DriftPrior,
    by_drift: Floats,
    curvature: Floats,
) -> tuple[Floats, Doubles]:
    """Pressures (m,) and the drift (14,) beside them that explain a change.

    `drift_cost` (grey^2) holds the drift back.

    `of_dent`, `pull`: columns^T change of dent and drift; `by_drift` (14, m), `curvature` (m, m):
    columns^T columns.
    """
    from pipeline.stages.depth.gel.change_kernels import descend_pressures

    projection = _invert(max(CHANGE.noise_grey**2, drift_cost) * drift.precision + drift.curvature)
    left = curvature - by_drift.T @ (projection @ by_drift).astype(np.float32)
    unit = np.asarray(
        np.maximum(np.diag(left), 1e-3 * float(np.diag(left).max())) ** -0.5, np.float32
    )
    left = np.asarray(left * unit * unit[:, None], np.float32)
    length = np.float32(1.1 * _estimate_norm(left))
    left[np.diag_indices_from(left)] += np.float32(1e-4)
    right = (of_dent - by_drift.T @ (projection @ pull)).astype(np.float32) * unit
    right -= np.float32(CHANGE.pressure_cost) * right.max()
    pressures = np.zeros_like(right)
    most = CHANGE.pressure_iterations
    descend_pressures(left / length, right / length, most, CHANGE.pressure_settled, pressures)
    pressures *= unit
    return np.asarray(pressures, np.float32), np.asarray(
        projection @ (pull - by_drift @ pressures), np.float64
    )


def _invert(matrix: Doubles) -> Doubles:
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _estimate_norm(curvature: Floats) -> float:
    """About the largest eigenvalue of a positive matrix, by powers."""
    vector = np.ones(len(curvature), np.float32)
    for _ in range(12):
        vector = curvature @ vector
        vector /= np.sqrt(vector @ vector)
    return float(vector @ (curvature @ vector))


@derive_once
def estimate_light(
    touches: tuple[Image, ...], reference: Image, source: SensorSpec, pixel_mm: float
) -> Floats:
    """Coarse light (rows, cols, 3, 2) of an instance, by touches of unknown shape.

    Described light without any.
    """
    described = describe_light(source)
    if not touches:
        return described
    basis = make_dent_basis(source, pixel_mm)
    drift = make_drift_prior(reference, source, pixel_mm)
    changes = [
        compute_block_change(image, reference, source.markers, pixel_mm).ravel()
        for image in touches
    ]
    light = described
    for _ in range(REST.light_iterations):
        columns = make_dent_columns(light, basis)
        by_drift = drift.columns.T @ columns
        curvature = columns.T @ columns
        normal = np.zeros((3, 12, 12))
        right = np.zeros((3, 12))
        for change in changes:
            cost = CHANGE.stiffness * float(change @ change) / change.size
            fitted = columns.T @ change, drift.columns.T @ change, cost
            pressures, beside = fit_dent(*fitted, drift, by_drift, curvature)
            slopes = basis.slopes @ pressures
            rates = make_turn_columns(described, slopes)
            left = (change - drift.columns @ beside).reshape(-1, 3) - (
                described * slopes[:, :, None]
            ).sum(-1).reshape(-1, 3)
            normal += np.einsum("nki,nkj->kij", rates, rates, optimize=True)
            right += np.einsum("nki,nk->ki", rates, left)
        strength = REST.light_ridge * np.trace(normal, axis1=1, axis2=2) / 12 + REST.light_doubt
        pull = strength[:, None, None] * np.eye(12)
        turns = np.linalg.solve(normal + pull, right[..., None]).reshape(3, 4, 3)
        if float(np.abs(turns[..., 0]).max()) > REST.turn_max:
            return described
        light = turn_light(described, turns)
    return freeze(light)


def turn_light(described: Floats, turns: Doubles) -> Floats:
    """The light (rows, cols, 3, 2), turned and scaled by `turns` (3, 4, 3): channel, kind, place
    (1, right, down).
    """
    by = np.einsum("rcp,ktp->rckt", _make_places(*described.shape[:2]), turns)
    x = described[..., 0]
    y = described[..., 1]
    return np.stack(
        [x * (1 + by[..., 0]) - y * by[..., 2], y * (1 + by[..., 1]) + x * by[..., 3]], -1
    ).astype(np.float32)


def make_turn_columns(described: Floats, slopes: Floats) -> Floats:
    """Derivative (rows x cols, 3, 12) by `turns` of the change by a dent of these `slopes`
    (rows, cols, 2).
    """
    x = described[..., 0]
    y = described[..., 1]
    gx = slopes[..., None, 0]
    gy = slopes[..., None, 1]
    kinds = np.stack([x * gx, y * gy, -y * gx, x * gy], -1)
    columns = kinds[..., None] * _make_places(*described.shape[:2])[:, :, None, None]
    return columns.reshape(-1, 3, 12).astype(np.float32)


@derive_once
def _make_places(rows: int, cols: int) -> Floats:
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : cols * 1j]
    return freeze(np.stack([np.ones_like(x), x, y], -1).astype(np.float32))


def correlate_colours(share: float) -> Doubles:
    """Correlation (3, 3) of the colours that share this much of their variance."""
    return share * np.ones((3, 3)) + (1 - share) * np.eye(3)
