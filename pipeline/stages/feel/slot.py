"""The slot *felt*: the depth of the generated touch, in the target's frame."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.base.params import NoParams
from pipeline.engine.graph import Method, unless
from pipeline.evaluation.metrics import surface_figures
from pipeline.pictures.layers import Layer, membrane_layer, surface_layer
from pipeline.pictures.picture import Picture, of_heights
from pipeline.stages.depth.stage import DepthParams
from pipeline.stages.feel import stage
from pipeline.stages.follow import in_depth
from pipeline.stages.slot import Facts, Mark, Seen, Slot
from pipeline.values.results import DepthMap

MEMBRANE = Method(
    slot="felt",
    name="membrane",
    title="Its membrane",
    help="the membrane that the touch was made with",
    run=unless(stage.without_contact, stage.membrane),
    params=NoParams,
    reads=("touch", "target"),
)
READING = Method(
    slot="felt",
    name="reading",
    title="Read as recorded",
    help="the picture goes through the target's own depth method",
    run=unless(stage.without_contact, stage.reading),
    params=DepthParams,
    reads=("touch", "target"),
)


def _picture(felt: DepthMap, seen: Seen) -> Picture:
    return of_heights(felt.indentation_mm, felt.depth_mm, felt.contact, felt.camera, seen.target, seen.display)


def _layers(felt: DepthMap, seen: Seen, picture: Picture) -> tuple[Layer, ...]:
    times = seen.display.stretch(seen.target)
    surface = surface_layer("felt", felt.depth_mm, felt.indentation_mm, felt.camera, picture.pixels, times)
    return (surface, membrane_layer(seen.target))


def _follow(felt: DepthMap, before: Mark) -> Mark:
    return in_depth("felt", felt, before)


def _figures(felt: DepthMap, facts: Facts) -> Mapping[str, float]:
    return {} if facts.target is None else surface_figures(felt.indentation_mm, felt.contact, facts.target)


SLOT = Slot(
    name="felt",
    title="Felt",
    legend="as the target feels it",
    place="target",
    methods=(MEMBRANE, READING),
    picture=_picture,
    layers=_layers,
    follow=_follow,
    figures=_figures,
)
