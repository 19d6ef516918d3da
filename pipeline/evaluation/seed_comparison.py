"""One frame's touch sampled with several seeds: their mean, standard deviation and error."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.errors import SettingProblem
from pipeline.base.params import list_settings
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.graph import Method
from pipeline.evaluation.comparison_tiles import Comparison
from pipeline.evaluation.variants import MethodParams, Variant, VariantRunner
from pipeline.previews.colours import ColourScale, apply_colour_map
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.preview import Preview, make_indentation_preview
from pipeline.previews.tile import Tile
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap

_STAGE = "touch_depth"
_SCALE_SHARE = 0.2  # scale of standard deviation and error as a share of the indentation's


def compare_seeds(
    runner: VariantRunner, translation: Translation, frame: int, params: MethodParams, display: DisplayParams,
    n_seeds: int, progress: Progress = SILENT,
) -> Iterator[Comparison]:  # fmt: skip
    """Tiles of the seeds so far, from the second on; seeds count up from the chosen one. Raises TouchError, Cancelled.

    The touch must be sampled: SettingProblem for other methods, and if all seeds give the same touch.
    """
    base = Variant(label="", translation=translation, params=params)
    method = _get_sampling_method(translation, base.stage_params)
    method_params = base.stage_params[method.stage]
    first = int(list_settings(method_params)["seed"][0])
    truth = translation.read_true_outputs(frame).get(_STAGE)
    truth = truth if isinstance(truth, DepthMap) else None
    title = f"frame {frame}, {method.title}"
    yield Comparison(tiles=(), summary=f"{title}: sampling")
    samples: list[DepthMap] = []
    for n in range(n_seeds):
        part = SubProgress(progress, n / n_seeds, 1.0 / n_seeds, f"seed {n + 1} of {n_seeds}")
        results = runner.evaluate(base.with_value(method, "seed", first + n), frame, [_STAGE], part).results
        touch, sample = results["touch"], results[_STAGE].output
        assert isinstance(sample, DepthMap)
        if touch.state == "skipped" or touch.fallback:
            raise SettingProblem(f"{title}: {(touch.notes or ('nothing is sampled',))[0]}")
        samples.append(sample)
        if n == 1 and np.array_equal(samples[0].indentation_mm, sample.indentation_mm, equal_nan=True):
            raise SettingProblem(_explain_equal_samples(title, method_params))
        if n:
            yield _build_comparison(samples, truth, translation, display, title, first)


def _get_sampling_method(translation: Translation, params: Mapping[str, object]) -> Method:
    """The touch method, if it samples; raises SettingProblem."""
    method = next((m for m in translation.methods if m.stage == "touch"), None)
    if method is None or _STAGE not in translation.stages:
        raise SettingProblem("this route generates no touch; choose another route")
    if method.weights is None or "seed" not in list_settings(params[method.stage]):
        raise SettingProblem(f"the touch by {method.title!r} is not sampled; choose T2D2 or T2T for it")
    return method


def _explain_equal_samples(title: str, params: object) -> str:
    text = f"{title}: every seed gives the same touch"
    if isinstance(params, DiffusionParams) and params.steps < 2:
        return f"{text}; one step gives the posterior mean, set touch.steps to 4 or more (F3) to sample"
    return text


def _build_comparison(
    samples: Sequence[DepthMap], truth: DepthMap | None, translation: Translation, display: DisplayParams, title: str,
    first: int,
) -> Comparison:  # fmt: skip
    target, last = translation.target, samples[-1]
    statistics = estimate_bias_variance(
        [sample.indentation_mm for sample in samples],
        None if truth is None else truth.indentation_mm, None if truth is None else truth.contact,
    )  # fmt: skip
    last_seed = first + len(samples) - 1

    def make_preview(heights_mm: Floats, depth: DepthMap) -> Preview:
        return make_indentation_preview(heights_mm, depth.depth_mm, depth.contact, depth.camera, target, display)

    mean = make_preview(statistics.mean_mm, last)
    std_mm, bias_mm = statistics.rms_std_mm, statistics.rms_bias_mm
    tiles = [
        Tile(title=f"mean of {len(samples)} seeds", subtitle=f"seeds {first} to {last_seed}", preview=mean),
        Tile(
            title="spread", subtitle=f"{std_mm:.3g} mm, standard deviation in contact (rms)",
            metrics={"rms_spread_mm": std_mm},
            preview=_make_error_preview(mean, statistics.std_mm, "standard deviation over seeds"),
        ),
        Tile(title="sample", subtitle=f"seed {last_seed}", preview=make_preview(last.indentation_mm, last)),
    ]  # fmt: skip
    if statistics.bias_mm is not None and truth is not None:
        error = Tile(
            title="error",
            subtitle=f"{bias_mm:.3g} mm, of the mean in contact (rms)",
            metrics={"rms_error_mm": bias_mm},
            preview=_make_error_preview(mean, np.abs(statistics.bias_mm), "absolute error of the mean"),
        )
        recorded = make_preview(truth.indentation_mm, truth)
        tiles = [
            *tiles[:2],
            error,
            tiles[2],
            Tile(title="truth", subtitle=f"recorded by {target.title}", preview=recorded),
        ]
    return Comparison(
        tiles=tuple(tiles), summary=f"{title}: {statistics.summary}",
        reliability_curve=tuple((float(std), float(error)) for std, error in statistics.compute_reliability_curve()),
    )  # fmt: skip


def _make_error_preview(mean: Preview, values_mm: Floats, quantity: str) -> Preview:
    """A map of errors on the scale that standard deviation and error share."""
    assert mean.scale is not None
    scale = ColourScale(
        colour_map="viridis", low=0.0, high=_SCALE_SHARE * mean.scale.high, unit="mm", quantity=quantity
    )
    return replace(mean, pixels=apply_colour_map(values_mm, scale), values=values_mm, scale=scale, caption=quantity)


_BINS = 12
_MIN_PIXELS = 30  # least number of pixels per point of the curve


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasVariance:
    """Samples of one membrane (rows, cols), in mm.

    The standard deviation of a calibrated sampler equals its error. If the error is larger, more samples do not help.
    """

    n_samples: int
    mean_mm: Floats
    std_mm: Floats  # standard deviation of one sample
    bias_mm: Floats | None  # mean less ground truth; None if unknown
    mask: Mask  # pixels of the summary: true contact, else all

    @property
    def rms_std_mm(self) -> float:
        """Standard deviation of one sample about the mean, rms over `mask`."""
        return _rms(self.std_mm, self.mask)

    @property
    def rms_bias_mm(self) -> float:
        """Bias of the mean, rms over `mask`; NaN if unknown."""
        return math.nan if self.bias_mm is None else _rms(self.bias_mm, self.mask)

    @property
    def summary(self) -> str:
        """Error of a sample, and how much of its square is variance or bias."""
        spread = f"{self.n_samples} samples have a standard deviation of {self.rms_std_mm:.3g} mm"
        if self.bias_mm is None or not math.isfinite(self.rms_bias_mm):
            return f"{spread}; their error is not known"
        # The mean of a few samples has a random error that is not bias.
        variance_sq = self.rms_std_mm**2
        bias_sq = max(0.0, self.rms_bias_mm**2 - variance_sq / self.n_samples)
        share = variance_sq / max(variance_sq + bias_sq, 1e-30)
        cause = "variance" if share > 0.5 else "bias, which more samples do not reduce"
        return (
            f"{spread} in contact and an error of {math.sqrt(variance_sq + bias_sq):.3g} mm (rms): "
            f"{max(share, 1.0 - share):.0%} of the square is {cause}"
        )

    def compute_reliability_curve(self) -> Doubles:
        """(k, 2): mean standard deviation and rms error of the mean per group of pixels of similar spread.

        Empty if ground truth is unknown.
        """
        if self.bias_mm is None:
            return np.zeros((0, 2))
        known = np.isfinite(self.bias_mm) & np.isfinite(self.std_mm)
        std, bias = self.std_mm[known].astype(np.float64), self.bias_mm[known].astype(np.float64)
        order = np.argsort(std, kind="stable")
        parts = [part for part in np.array_split(order, _BINS) if part.size >= _MIN_PIXELS]
        points = [(std[part].mean(), math.sqrt(float((bias[part] ** 2).mean()))) for part in parts]
        return np.array(points).reshape(-1, 2)


def estimate_bias_variance(samples_mm: Sequence[Floats], true_mm: Floats | None, contact: Mask | None) -> BiasVariance:
    """Statistics of samples (rows, cols) in mm; `contact` is the true one. Raises SettingProblem for fewer than two."""
    if len(samples_mm) < 2:
        raise SettingProblem("a standard deviation needs two samples or more")
    stack = np.asarray(samples_mm, np.float64)
    mean = stack.mean(axis=0)
    shape = mean.shape
    fits = true_mm is not None and true_mm.shape == shape
    where = contact if contact is not None and contact.shape == shape and contact.any() else np.ones(shape, np.bool_)
    return BiasVariance(
        n_samples=len(samples_mm), mean_mm=freeze(mean.astype(np.float32)),
        std_mm=freeze(stack.std(axis=0, ddof=1).astype(np.float32)),
        bias_mm=freeze((mean - true_mm).astype(np.float32)) if fits else None, mask=where,
    )  # fmt: skip


def _rms(values: Floats, where: Mask) -> float:
    inside = values[where].astype(np.float64)
    inside = inside[np.isfinite(inside)]
    return math.sqrt(float((inside**2).mean())) if inside.size else math.nan
