"""Metrics of one generated touch per region, and of many touches together.

Touches are compared as changes from the reference: a gel's image less its reference image, a
bubble's imprint. Markers and illumination differ between sensor instances, and a generated touch is
of the described instance. Image similarity is therefore computed on the change added to the
recorded instance's reference image.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.metrics.stage_metrics import PSNR_CAP_DB, Metric, compute_mae_mm, iou

Region = Literal["all", "contact", "visible", "outside"]
REGIONS: Mapping[Region, str] = {
    "all": "the whole image",
    "contact": "true contact",
    "visible": "visible to the source",
    "outside": "outside the source's view",
}
GREY_PEAK = 255.0


@frozen
class RecordedTouch:
    """The target's frame of a touch with its ground truth."""

    change: Floats  # (rows, cols, channels) brightness as a share of full scale, or imprint in mm
    image: Doubles  # (rows, cols, channels) for image similarity
    reference: Doubles | None  # reference image of a gel (rows, cols, 3) in grey levels
    indentation_mm: Floats
    contact: Mask
    is_depth: bool
    peak_value: float  # of an image, for PSNR and SSIM

    @property
    def noise_free_change(self) -> Floats:
        """The change without depth camera noise.

        A gel's as recorded, with a noise of 1 to 2 grey levels.
        """
        return self.indentation_mm[..., None] if self.is_depth else self.change

    def compute_region_masks(self, known: Mask) -> dict[Region, Mask]:
        """Masks (rows, cols) of the regions that are not empty.

        `known` is what is visible to the source.
        """
        masks: dict[Region, Mask] = {
            "all": np.ones(self.contact.shape, np.bool_),
            "contact": self.contact,
            "visible": known,
            "outside": ~known,
        }
        return {name: mask for name, mask in masks.items() if mask.any()}

    def render_image(self, changed: Floats) -> Doubles:
        """The image (rows, cols, channels) that this sensor instance records of a change."""
        if self.reference is None:
            return changed.astype(np.float64)
        return np.clip(self.reference + GREY_PEAK * changed.astype(np.float64), 0.0, GREY_PEAK)


def build_recorded_touch(
    frame: TactileFrame,
    sensor: SensorSpec,
    indentation_mm: Floats | None = None,
    contact: Mask | None = None,
) -> RecordedTouch:
    """Recorded touch with its truth; without truth the indentation is NaN, and nothing in contact.
    Raises SettingProblem without reference.
    """
    if frame.reference is None:
        raise SettingProblem(
            f"frame {frame.index} has no reference to compare with; give --reference"
        )
    change = sensor.sensor_kind.compute_relative_change(frame.image, frame.reference)
    reference = None if frame.is_depth else frame.reference.astype(np.float64)
    image = change.astype(np.float64) if reference is None else frame.image.astype(np.float64)
    shape = frame.image.shape[:2]
    return RecordedTouch(
        change=change,
        image=image,
        reference=reference,
        indentation_mm=np.full(shape, np.nan, np.float32)
        if indentation_mm is None
        else indentation_mm,
        contact=np.zeros(shape, np.bool_) if contact is None else contact,
        is_depth=frame.is_depth,
        peak_value=sensor.sensor_kind.peak_change,
    )


def compute_generated_change(touch: GeneratedTouch, target: SensorSpec) -> Floats:
    """Change (rows, cols, channels) of a generated touch from the described instance's
    reference.
    """
    return target.sensor_kind.compute_relative_change(touch.image, render_reference(target))


TOUCH_METRICS: Mapping[str, Metric] = {
    "psnr_db": Metric(
        unit="dB",
        better="higher",
        meaning="over the pixels of all touches together, as in the paper's code",
    ),
    "ssim": Metric(unit="", better="higher", meaning="similarity to the recorded touch"),
    "psnr_exact_db": Metric(
        unit="dB", better="higher", meaning="the same against a bubble's imprint without noise"
    ),
    "ssim_exact": Metric(
        unit="", better="higher", meaning="the same against a bubble's imprint without noise"
    ),
    "error_mm": Metric(unit="mm", better="lower", meaning="mean absolute error of the membrane"),
    "iou": Metric(unit="", better="higher", meaning="overlap of contact"),
    "correlation": Metric(
        unit="", better="higher", meaning="with the true change, both less the mean touch"
    ),
}
MIN_GRASPS = 5  # for an interval
# percentiles
_N_DRAWS = 1000
_INTERVAL = (2.5, 97.5)
# metric -> squared error that it is computed from
_SQUARED = {"psnr_db": "squared", "psnr_exact_db": "squared_exact"}


@frozen
class TouchMetrics:
    """Metrics of one touch: (metric, region) -> finite value; unknown ones are absent."""

    values: Mapping[tuple[str, Region], float]
    n_pixels: Mapping[Region, int]
    peak_value: float


def compute_touch_metrics(
    made: Floats,
    touch_depth: DepthMap | None,
    true: RecordedTouch,
    known: Mask,
    mean: Floats | None,
) -> TouchMetrics:
    """All metrics of a generated change (rows, cols, channels).

    `touch_depth` is its membrane, if known; `known` (rows, cols) is what the source sees; `mean` is
    the mean change of other touches of this sensor, None leaves out the correlation.
    """
    regions = true.compute_region_masks(known)
    values: dict[tuple[str, Region], float] = {}
    image = true.render_image(made)
    exact = true.render_image(true.noise_free_change)
    ssim_map = compute_similarity_map(image, true.image, true.peak_value)
    ssim_map_exact = (
        compute_similarity_map(image, exact, true.peak_value) if true.is_depth else ssim_map
    )
    inner = np.zeros(true.contact.shape, np.bool_)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    membrane = made[..., 0] if true.is_depth else touch_depth and touch_depth.indentation_mm
    for region, where in regions.items():
        metrics = {
            "squared": _mean((image - true.image) ** 2, where),
            "squared_exact": _mean((image - exact) ** 2, where),
            "ssim": _mean(ssim_map, where & inner),
            "ssim_exact": _mean(ssim_map_exact, where & inner),
        }
        if membrane is not None:
            metrics["error_mm"] = compute_mae_mm(membrane, true.indentation_mm, where)
        if touch_depth is not None and (true.contact & where).any():
            metrics["iou"] = iou(touch_depth.contact & where, true.contact & where)
        if mean is not None:
            metrics["correlation"] = _correlation(made - mean, true.noise_free_change - mean, where)
        values |= {(name, region): value for name, value in metrics.items() if math.isfinite(value)}
    counts: dict[Region, int] = {
        region: int(np.count_nonzero(where)) for region, where in regions.items()
    }
    return TouchMetrics(values=values, n_pixels=counts, peak_value=true.peak_value)


def pool_metrics(touches: Sequence[TouchMetrics]) -> dict[str, dict[str, float]]:
    """Metric -> region -> value of many touches: PSNR over all pixels together, otherwise the
    mean over touches.
    """
    pooled: dict[str, dict[str, float]] = {}
    for name, source, region in _list_sources(touches):
        those = [one for one in touches if (source, region) in one.values]
        values = np.array([one.values[source, region] for one in those])
        if source != name:
            weights = np.array([one.n_pixels[region] for one in those], np.float64)
            value = _psnr_db(float(np.average(values, weights=weights)), those[0].peak_value)
        else:
            value = float(values.mean())
        pooled.setdefault(name, {})[region] = value
    return pooled


def _list_sources(touches: Sequence[TouchMetrics]) -> list[tuple[str, str, Region]]:
    """(metric, value that it is pooled from, region) of all that is known of some touch."""
    keys = dict.fromkeys(key for one in touches for key in one.values)
    return [
        (name, source, region)
        for name in TOUCH_METRICS
        for source, region in keys
        if source == _SQUARED.get(name, name)
    ]


def bootstrap_metrics(
    touches: Sequence[TouchMetrics], grasps: Sequence[str]
) -> dict[str, dict[str, tuple[float, float]]]:
    """Metric -> region -> 95 % interval of the pooled value, over draws of grasps with replacement.

    `grasps` names the grasp of each touch, whose fingers are drawn together. Fewer than
    `MIN_GRASPS` give no interval.
    """
    names = list(dict.fromkeys(grasps))
    if len(names) < MIN_GRASPS:
        return {}
    counts = np.random.default_rng(0).multinomial(
        len(names), np.full(len(names), 1.0 / len(names)), _N_DRAWS
    )
    # a row per draw, a column per touch
    weights = counts[:, [names.index(grasp) for grasp in grasps]].astype(np.float64)
    intervals: dict[str, dict[str, tuple[float, float]]] = {}
    for name, source, region in _list_sources(touches):
        values = np.array([one.values.get((source, region), np.nan) for one in touches])
        shares = [one.n_pixels.get(region, 0) if source != name else 1.0 for one in touches]
        of_touch = weights * np.where(np.isfinite(values), shares, 0.0)
        total = of_touch.sum(axis=1)
        means = (of_touch @ np.nan_to_num(values))[total > 0] / total[total > 0]
        if source != name:
            means = np.array([_psnr_db(float(mean), touches[0].peak_value) for mean in means])
        low, high = np.percentile(means, _INTERVAL)
        intervals.setdefault(name, {})[region] = float(low), float(high)
    return intervals


def _psnr_db(squared: float, peak: float) -> float:
    return (
        min(PSNR_CAP_DB, 10.0 * math.log10(peak * peak / squared)) if squared > 0 else PSNR_CAP_DB
    )


def _mean(values: Doubles, where: Mask) -> float:
    return float(values[where].mean()) if where.any() else math.nan


def _correlation(a: Floats, b: Floats, where: Mask) -> float:
    """Correlation of two changes in a region over all channels; NaN if one is constant."""
    flat = (v[where].astype(np.float64).ravel() for v in (a, b))
    x, y = (v - v.mean() for v in flat)
    size = math.sqrt(float(x @ x) * float(y @ y))
    return float(x @ y) / size if size > 0 else math.nan


BORDER_PX = 5  # half the window: nearer to the border it exceeds the image
_SIGMA_PX = 1.5
_K1 = 0.01
_K2 = 0.03


def compute_similarity_map(a: NDArray[Any], b: NDArray[Any], data_range: float) -> Doubles:
    """Return the similarity, 1 = equal, at every pixel (rows, cols) of images (rows, cols) or
    (rows, cols, channels).

    Structural similarity (Wang et al. 2004); mean over channels, of finite values. Gaussian window
    of 11 pixels, population covariance, as scikit-image's `structural_similarity` with
    `gaussian_weights=True, sigma=1.5, use_sample_covariance=False`, which averages pixels farther
    than `BORDER_PX` from the border; pixels beyond it are mirrored.
    """
    one, other = (np.asarray(image, np.float64) for image in (a, b))
    if one.ndim == 3:
        return np.mean(
            [_map(one[..., k], other[..., k], data_range) for k in range(one.shape[2])], axis=0
        )
    return _map(one, other, data_range)


def _map(a: Doubles, b: Doubles, data_range: float) -> Doubles:
    mean_a = _blur(a)
    mean_b = _blur(b)
    var_a = _blur(a * a) - mean_a**2
    var_b = _blur(b * b) - mean_b**2
    together = _blur(a * b) - mean_a * mean_b
    c1 = (_K1 * data_range) ** 2
    c2 = (_K2 * data_range) ** 2
    alike = (2 * mean_a * mean_b + c1) * (2 * together + c2)
    return alike / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))


def _blur(image: Doubles) -> Doubles:
    import cv2

    size = (2 * BORDER_PX + 1,) * 2
    blurred = cv2.GaussianBlur(image, size, _SIGMA_PX, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float64)
