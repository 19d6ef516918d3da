"""The slot *depth*: how far the source's membrane is pushed in."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.engine.graph import Method, unless
from pipeline.evaluation.metrics import surface_figures
from pipeline.pictures.layers import Layer, surface_layer
from pipeline.pictures.picture import Picture, of_heights
from pipeline.stages.depth import stage
from pipeline.stages.follow import in_depth
from pipeline.stages.slot import Facts, Mark, Seen, Slot
from pipeline.values.results import DepthMap

PHYSICS = Method(
    slot="depth",
    name="physics",
    title="Physics",
    help="colour look-up and integration for a gel, load on the membrane for a bubble",
    run=unless(stage.untouched, stage.depth),
    params=stage.DepthParams,
    reads=("frame", "source", "calibration"),
    version=3,
)


def _picture(depth: DepthMap, seen: Seen) -> Picture:
    return of_heights(depth.indentation_mm, depth.depth_mm, depth.contact, depth.camera, seen.source, seen.display)


def _layers(depth: DepthMap, seen: Seen, picture: Picture) -> tuple[Layer, ...]:
    times = seen.display.stretch(seen.source)
    return (surface_layer("depth", depth.depth_mm, depth.indentation_mm, depth.camera, picture.pixels, times),)


def _follow(depth: DepthMap, before: Mark) -> Mark:
    return in_depth("depth", depth, before)


def _figures(depth: DepthMap, facts: Facts) -> Mapping[str, float]:
    return {} if facts.source is None else surface_figures(depth.indentation_mm, depth.contact, facts.source)


SLOT = Slot(
    name="depth",
    title="Depth",
    legend="membrane",
    place="source",
    methods=(PHYSICS,),
    picture=_picture,
    layers=_layers,
    follow=_follow,
    figures=_figures,
)
