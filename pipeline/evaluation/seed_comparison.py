"""One frame's touch sampled with several seeds: their mean, standard deviation and error."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import list_settings
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.graph import Method
from pipeline.evaluation.bias_variance import estimate_bias_variance
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
