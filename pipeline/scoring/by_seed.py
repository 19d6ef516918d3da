"""One frame's touch drawn with several seeds: what all of them say, and how far they spread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.params import changed, settings
from pipeline.base.progress import SILENT, Progress, Share
from pipeline.engine.graph import Graph, Method
from pipeline.pictures.colours import ColourScale, coloured
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.picture import Picture, of_heights
from pipeline.pictures.tiles import Tile
from pipeline.scoring.luck import Luck, luck
from pipeline.scoring.tiles import HandOver, Tiles, nobody
from pipeline.stages.generate.diffusion import DiffusionParams
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap

_SHARE = 0.2  # of the indentation's scale: spread and error are smaller than what they are of


def by_seed(
    translation: Translation, frame: int, given: Mapping[str, object], display: DisplayParams, count: int,
    like: Graph | None = None, *, hand_over: HandOver = nobody, progress: Progress = SILENT,
) -> Tiles:  # fmt: skip
    """A frame by `count` seeds, from its own on; `given` are parameters of methods by key. Raises TouchError.

    Handed over as they come; what is above the touch is taken from a graph `like` it where that has it.
    """
    told = {m.slot: given.get(m.key, m.params()) for m in translation.methods}
    method = _drawn(translation, told)
    params = told[method.slot]
    first = int(settings(params)["seed"][0])
    true = translation.truths(frame).get("felt")
    true = true if isinstance(true, DepthMap) else None
    title = f"frame {frame}, {method.title}"
    found: list[DepthMap] = []
    shown = Tiles(tiles=(), told=f"{title}: drawing")
    for n in range(count):
        part = Share(progress, n / count, 1.0 / count, f"seed {n + 1} of {count}")
        seeded = {**told, method.slot: changed(params, "seed", first + n)}
        graph = translation.graph(like=like)
        results = graph.evaluate(
            ["felt"], translation.inputs(frame), seeded, part
        )  # fmt: skip
        felt = results["felt"].output
        assert isinstance(felt, DepthMap)
        if results["touch"].state == "skipped" or results["touch"].instead:
            raise SettingProblem(f"{title}: {(results['touch'].notes or ('nothing is drawn',))[0]}")
        found.append(felt)
        if n == 1 and np.array_equal(found[0].indentation_mm, felt.indentation_mm, equal_nan=True):
            raise SettingProblem(_all_one(title, params))
        if n:
            shown = _shown(found, true, translation, display, title, first)
            hand_over(shown)
    return shown


def _drawn(translation: Translation, told: Mapping[str, object]) -> Method:
    """The method of the touch, if it draws; raises SettingProblem."""
    method = next((m for m in translation.methods if m.slot == "touch"), None)
    if method is None or "felt" not in translation.slots:
        raise SettingProblem("this route makes no touch; choose another route")
    if method.weights is None or "seed" not in settings(told[method.slot]):
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
) -> Tiles:
    target, last = translation.target, found[-1]
    told = luck(
        [felt.indentation_mm for felt in found],
        None if true is None else true.indentation_mm, None if true is None else true.contact,
    )  # fmt: skip

    def drawn(heights: Floats, felt: DepthMap) -> Picture:
        return of_heights(heights, felt.depth_mm, felt.contact, felt.camera, target, display)

    mean = drawn(told.mean_mm, last)
    truth = None if true is None else drawn(true.indentation_mm, true)
    tiles = [
        Tile(title=f"mean of {told.count} seeds", told=f"seeds {first} to {first + told.count - 1}", picture=mean),
        Tile(
            title="spread", told=f"{told.rms_spread_mm:.3g} mm, standard deviation in contact (rms)",
            figures={"rms_spread_mm": told.rms_spread_mm},
            picture=_of_error(mean, told.spread_mm, "standard deviation over seeds"),
        ),
        Tile(title="one of them", told=f"seed {first + told.count - 1}", picture=drawn(last.indentation_mm, last)),
    ]  # fmt: skip
    if told.off_mm is not None and truth is not None:
        off = _of_error(mean, np.abs(told.off_mm), "error of the mean, without its sign")
        tiles.insert(
            2,
            Tile(
                title="error",
                told=f"{told.rms_off_mm:.3g} mm, of the mean in contact (rms)",
                figures={"rms_error_mm": told.rms_off_mm},
                picture=off,
            ),
        )
        tiles.append(Tile(title="truth", told=f"{target.title}'s own", picture=truth))
    return Tiles(tiles=tuple(tiles), told=f"{title}: {told.sentence}", curve=_points(told))


def _of_error(mean: Picture, values: Floats, quantity: str) -> Picture:
    """Spread and error share one scale, so that the two can be held against each other."""
    assert mean.scale is not None
    scale = ColourScale(map="viridis", low=0.0, high=_SHARE * mean.scale.high, unit="mm", quantity=quantity)
    return replace(mean, pixels=coloured(values, scale), values=values, scale=scale, caption=quantity)


def _points(told: Luck) -> tuple[tuple[float, float], ...]:
    return tuple((float(spread), float(off)) for spread, off in told.curve())
