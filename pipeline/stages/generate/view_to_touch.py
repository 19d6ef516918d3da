"""Touch to depth to touch, compact: the physical render of the view, and the residual that a denoiser samples on it.

What a bubble feels beside what a gel felt is no matter of physics but of knowing objects; the network has seen many,
as the target itself feels them, and no pair of two sensors. With no step at all physics remains, to the byte.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, Share
from pipeline.engine.digests import content
from pipeline.networks import shelf
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.generate import stage
from pipeline.stages.generate.caution import held_back, trust
from pipeline.stages.generate.corrected import Unsure, corrected, on_grid
from pipeline.stages.generate.diffusion import DiffusionParams, sampled
from pipeline.stages.generate.residual_input import COARSER, of_view, working
from pipeline.stages.generate.stage import GenerateParams
from pipeline.values.results import DepthMap, TargetView, Touch

if TYPE_CHECKING:
    from torch import nn

SHIPPED = {"bubble": "t2d2_bubble", "gel": "t2d2_gelslim"}
LEARNED_PX_MM = {"bubble": 0.43, "gel": 0.0843}  # of the working grid
AS_IT_IS = 1.25  # how much finer or coarser a target may be
_HALF = 0.5


def weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:  # noqa: ARG001 - any source
    """The weights of a target; whatever the source: none was ever learned from."""
    found = shelf.for_task("residual_of_view", SHIPPED[target.kind], file)
    return found if file is not None else found if fits(target) else NoWeights(why=misfit(target))


def fits(target: SensorSpec) -> bool:
    """Whether the target's pixels are about as large as those that were learned on."""
    return 1 / AS_IT_IS < working(target).pixel_mm / LEARNED_PX_MM[target.kind] < AS_IT_IS


def misfit(target: SensorSpec) -> str:
    """Why no weights that come along suit a target."""
    learned = LEARNED_PX_MM[target.kind]
    return f"pixels of {working(target).pixel_mm:.3g} mm are not those of {learned:g} mm that the network knows"


def without_contact(
    view: TargetView,
    target: SensorSpec,
    weights: Weights | NoWeights,  # noqa: ARG001 - the method's arguments
    params: DiffusionParams,  # noqa: ARG001 - the method's arguments
) -> Touch | None:
    """The target's untouched reading when the view has no contact, else None: no weights are looked at."""
    return stage.without_contact(view, target, GenerateParams())


def generate(
    view: TargetView, target: SensorSpec, network: nn.Module, params: DiffusionParams, progress: Progress = SILENT
) -> Touch:
    """What `target` would have recorded of `view`; raises ShapeError when the view is of another image size."""
    rendering = Share(progress, 0.0, 0.3) if params.steps else progress
    physical = _render(view, target, GenerateParams(noise=params.noise, seed=params.seed), rendering)
    at_first = physical.membrane
    if not params.steps or at_first is None or not at_first.contact.any():
        return physical
    learned = target.kind == "bubble"
    found = sampled(network, condition(view, at_first, target), params, Share(progress, 0.3, 0.7), draws=learned)
    if learned:  # a gel that felt the object did so for certain
        felt = np.where(on_grid(view.contact, working(target).camera.shape) > _HALF, 1.0, 0.0).astype(np.float32)
        found = replace(found, last=replace(found.last, contact=np.maximum(found.last.contact, felt)))
    beyond = found.spread_mm[on_grid(view.known, found.spread_mm.shape) < _HALF]
    told = float((beyond if beyond.size else found.spread_mm).mean())
    where = "beyond what the source felt" if beyond.size else "all over"
    wide_mm = 0.0
    if params.steps == 1:  # a sample is one of many: all of it, and as sharp as it is
        # Of a gel, physics knows contact better: overlap 0.696, not 0.692, of 78 touches that are in no table.
        found = held_back(found, view.known, params.caution, trust(network), contact=learned)
        wide_mm = _told_mm(view, target)
    note = f"{where} the touch is learned, and expected to be off by {told:.2g} mm"
    found = replace(found, notes=(*found.notes, note))
    blur_px, reach_px = cast("float", network.blur_px), cast("float", network.reach_px)
    unsure = Unsure(blur_mm=wide_mm * blur_px, reach_mm=wide_mm * reach_px)
    return corrected(physical, target, found, params.seed if params.noise else None, unsure)


def _told_mm(view: TargetView, target: SensorSpec) -> float:
    """How wide a pixel of the source is on the target's plane; 0 where it is finer than the working grid."""
    points = view.source_index[view.contact]
    told = np.unique(points[points >= 0]).size
    wide_px = math.sqrt(points.size / told) if told else 1.0
    return wide_px * target.pixel_mm if wide_px > COARSER[target.kind] else 0.0


def _render(view: TargetView, target: SensorSpec, params: GenerateParams, progress: Progress) -> Touch:
    """The physical render; the last few are kept, so that a dragged slider costs passes of the network alone."""
    key = content(view), content(target), params
    return _rendered.of(key, lambda: stage.generate(view, target, params, progress))


_rendered: Memo[tuple[str, str, GenerateParams], Touch] = Memo(4)


def condition(view: TargetView, physical: DepthMap, target: SensorSpec) -> Floats:
    """(channels, rows, cols) on the working grid; see `residual_input.of_view`."""
    shape = working(target).camera.shape
    share = on_grid(view.contact, shape)
    told = on_grid(np.where(view.contact, view.indentation_mm, np.float32(0.0)), shape) / np.maximum(share, 1e-6)
    felt = share > _HALF
    return of_view(
        target.kind, np.where(felt, told, 0.0).astype(np.float32), felt, on_grid(view.known, shape) > _HALF,
        on_grid(physical.indentation_mm, shape), on_grid(physical.contact, shape) > _HALF,
    )  # fmt: skip
