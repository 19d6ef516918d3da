"""What a column shows beside what was worked out: the truth, or the difference to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from pipeline.previews.difference import compute_difference
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.layers import Layer
from pipeline.previews.preview import Preview, make_indentation_preview
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.stage import PreviewContext, Stage
from pipeline.values.results import DepthMap

ComparisonMode = Literal["", "truth", "difference", "wipe", "blink"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthView:
    """The truth of one slot, drawn; `gap` None where the two cannot be subtracted."""

    truth: Preview
    difference_to_truth: Preview | None
    layers: tuple[Layer, ...] = ()  # of the truth


def build_observation_view(made: Preview, observed: DepthMap, target: SensorSpec, display: DisplayParams) -> TruthView:
    """What an alignment carries over beside what the target felt itself, measured as any reading is."""
    own = make_indentation_preview(
        observed.indentation_mm, observed.depth_mm, observed.contact, observed.camera, target, display
    )
    gap = compute_difference(made, own, label="carried over less felt", fit_scale=True)
    return TruthView(truth=replace(own, caption=f"felt by {target.name} itself"), difference_to_truth=gap)


def build_truth_view(stage: Stage, made: Preview, truths: Mapping[str, Any], seen: PreviewContext) -> TruthView | None:
    """The truth's picture, made as the slot's own is; None where the recording does not know it."""
    if stage.name not in truths:
        return None
    known = replace(seen, outputs={**seen.outputs, **truths})
    true = stage.make_preview(truths[stage.name], known)
    return TruthView(
        truth=replace(true, caption=f"truth: {true.caption}"), difference_to_truth=compute_difference(made, true),
        layers=stage.make_layers(truths[stage.name], known, true),
    )  # fmt: skip
