"""One frame's touch drawn with several seeds: what all of them say, and how far they spread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import list_settings, replace_value
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.graph import Graph, Method
from pipeline.evaluation.bias_variance import BiasVariance, estimate_bias_variance
from pipeline.evaluation.comparison_tiles import ComparisonTiles, TilesCallback, ignore_tiles
from pipeline.previews.colours import ColourScale, apply_colour_map
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.preview import Preview, make_indentation_preview
from pipeline.previews.tile import Tile
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap

_SHARE = 0.2  # of the indentation's scale: spread and error are smaller than what they are of


def sweep_seeds(
    translation: Translation, frame: int, given: Mapping[str, object], display: DisplayParams, count: int,
    like: Graph | None = None, *, hand_over: TilesCallback = ignore_tiles, progress: Progress = SILENT,
) -> ComparisonTiles:  # fmt: skip
    """A frame by `count` seeds, from its own on; `given` are parameters of methods by key. Raises TouchError.

    Handed over as they come; what is above the touch is taken from a graph `like` it where that has it.
    """
    told = {m.stage: given.get(m.key, m.params()) for m in translation.methods}
    method = _drawn(translation, told)
    params = told[method.stage]
    first = int(list_settings(params)["seed"][0])
    true = translation.read_true_outputs(frame).get("touch_depth")
    true = true if isinstance(true, DepthMap) else None
    title = f"frame {frame}, {method.title}"
    found: list[DepthMap] = []
    shown = ComparisonTiles(tiles=(), summary=f"{title}: drawing")
    for n in range(count):
        part = SubProgress(progress, n / count, 1.0 / count, f"seed {n + 1} of {count}")
        seeded = {**told, method.stage: replace_value(params, "seed", first + n)}
        graph = translation.build_graph(like=like)
        results = graph.evaluate(
            ["touch_depth"], translation.read_inputs(frame), seeded, part
        )  # fmt: skip
        felt = results["touch_depth"].output
        assert isinstance(felt, DepthMap)
        if results["touch"].state == "skipped" or results["touch"].fallback:
            raise SettingProblem(f"{title}: {(results['touch'].notes or ('nothing is drawn',))[0]}")
        found.append(felt)
        if n == 1 and np.array_equal(found[0].indentation_mm, felt.indentation_mm, equal_nan=True):
            raise SettingProblem(_all_one(title, params))
        if n:
            shown = _shown(found, true, translation, display, title, first)
            hand_over(shown)
    return shown


def _drawn(translation: Translation, params: Mapping[str, object]) -> Method:
    """The method of the touch, if it draws; raises SettingProblem."""
    method = next((m for m in translation.methods if m.stage == "touch"), None)
    if method is None or "touch_depth" not in translation.stages:
        raise SettingProblem("this route makes no touch; choose another route")
    if method.weights is None or "seed" not in list_settings(params[method.stage]):
        raise SettingProblem(f"the touch by {method.title!r} is not drawn by chance; choose T2D2 or T2T for it")
    return method


def _all_one(title: str, params: object) -> str:
    told = f"{title}: every seed gives the very same touch"
    if isinstance(params, DiffusionParams) and params.steps < 2:
        return f"{told}; one step gives the likeliest one, set touch.steps to 4 or more (F3) to draw samples"
    return told


def _shown(
    found: list[DepthMap],
    true: DepthMap | None,
    translation: Translation,
    display: DisplayParams,
    title: str,
    first: int,
) -> ComparisonTiles:
    target, last = translation.target, found[-1]
    told = estimate_bias_variance(
        [felt.indentation_mm for felt in found],
        None if true is None else true.indentation_mm, None if true is None else true.contact,
    )  # fmt: skip

    def draw_heights(heights: Floats, touch_depth: DepthMap) -> Preview:
        return make_indentation_preview(
            heights, touch_depth.depth_mm, touch_depth.contact, touch_depth.camera, target, display
        )

    mean = draw_heights(told.mean_mm, last)
    truth = None if true is None else draw_heights(true.indentation_mm, true)
    tiles = [
        Tile(title=f"mean of {told.n_samples} seeds", subtitle=f"seeds {first} to {first + told.n_samples - 1}", preview=mean),
        Tile(
            title="spread", subtitle=f"{told.rms_std_mm:.3g} mm, standard deviation in contact (rms)",
            metrics={"rms_spread_mm": told.rms_std_mm},
            preview=_of_error(mean, told.std_mm, "standard deviation over seeds"),
        ),
        Tile(title="one of them", subtitle=f"seed {first + told.n_samples - 1}", preview=draw_heights(last.indentation_mm, last)),
    ]  # fmt: skip
    if told.bias_mm is not None and truth is not None:
        off = _of_error(mean, np.abs(told.bias_mm), "error of the mean, without its sign")
        tiles.insert(
            2,
            Tile(
                title="error",
                subtitle=f"{told.rms_bias_mm:.3g} mm, of the mean in contact (rms)",
                metrics={"rms_error_mm": told.rms_bias_mm},
                preview=off,
            ),
        )
        tiles.append(Tile(title="truth", subtitle=f"{target.title}'s own", preview=truth))
    return ComparisonTiles(tiles=tuple(tiles), summary=f"{title}: {told.summary}", reliability_curve=_points(told))


def _of_error(mean: Preview, values: Floats, quantity: str) -> Preview:
    """Spread and error share one scale, so that the two can be held against each other."""
    assert mean.scale is not None
    scale = ColourScale(colour_map="viridis", low=0.0, high=_SHARE * mean.scale.high, unit="mm", quantity=quantity)
    return replace(mean, pixels=apply_colour_map(values, scale), values=values, scale=scale, caption=quantity)


def _points(statistics: BiasVariance) -> tuple[tuple[float, float], ...]:
    return tuple((float(spread), float(off)) for spread, off in statistics.compute_reliability_curve())
