"""Touch to touch, compact: the target's touch from the source's reading alone, learned from pairs; no depth between.

Of an object that it has never seen it may be sure of a body that is not there. One step, the likeliest touch, is
therefore drawn toward the physical render where it is unsure, for the time that this costs, and given up for it where
it contradicts what the source felt; without caution, and of samples, nothing but the network is asked.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.doubts import Doubt, doubts
from pipeline.base.errors import ShapeError
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, Share
from pipeline.calibration.lookup import Calibration
from pipeline.engine.digests import content
from pipeline.engine.graph import Method, Skipped
from pipeline.networks import building, shelf
from pipeline.networks.weights import NoWeights, Weights
from pipeline.physics import optics
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.adapt import stage as adaptation
from pipeline.stages.depth import network as depth_network
from pipeline.stages.depth import stage as depth
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.stages.generate import stage, view_to_touch
from pipeline.stages.generate.caution import against, contradiction, held_back, trust
from pipeline.stages.generate.corrected import Unsure, corrected
from pipeline.stages.generate.diffusion import DiffusionParams, sampled
from pipeline.stages.generate.picture_input import of_picture
from pipeline.stages.generate.reach import deep
from pipeline.stages.generate.residual_input import working
from pipeline.stages.project import stage as projection
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, Touch

if TYPE_CHECKING:
    from torch import nn

SHIPPED = {("gelslim", "bubble"): "t2t_bubble", ("soft_bubble", "gel"): "t2t_gelslim"}
LEARNED = "touch_to_touch", "kept_pairs"  # tasks: pairs that were simulated, and real ones on top
_CONTRADICTED = 3.0  # times; of 70 touches that were not learned from five come to as much
ALONE = "no contact is read from the picture: what touches here is what the network alone makes of it"
READS = ("frame", "source", "calibration", "alignment", "target")


def weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights of a source and a target: only those two that pairs were learned from."""
    name = SHIPPED.get((source.name, target.kind))
    if file is None and (name is None or not view_to_touch.fits(target)):
        return NoWeights(why=f"no pairs of {source.title} and {target.title} were ever learned from")
    return shelf.for_task(LEARNED, name or "", file)


def generate(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    network: nn.Module,
    params: DiffusionParams,
    progress: Progress = SILENT,
) -> Touch | Skipped:
    """What `target` would have recorded of the touch in `frame`; raises ShapeError for a frame that cannot be read.

    An untouched frame gives the untouched target and costs nothing; no denoising step gives the physical render.
    """
    depth.checked(frame, source)
    rest, seed = stage.at_rest(target), params.seed if params.noise else None
    if depth.untouched(frame, source, calibration, depth.DepthParams()) is not None:
        return Skipped(output=rest, why=stage.NO_CONTACT)
    careful = params.steps == 1 and params.caution > 0.0
    physical = rest
    if careful or not params.steps:
        wanted = stage.GenerateParams(noise=params.noise, seed=params.seed)
        physical = _physical(frame, source, calibration, alignment, target, wanted, Share(progress, 0.0, 0.8))
    if not params.steps:
        return physical
    asked = Share(progress, 0.8, 0.2) if careful else progress
    found = sampled(network, condition(frame, source, alignment, target), params, asked, draws=target.kind == "bubble")
    membrane = physical.membrane
    if not careful or membrane is None or not membrane.contact.any():
        alone = (Doubt(ALONE),) if careful else ()  # what is said of a target at rest is not said of this touch
        made = corrected(replace(rest, notes=alone), target, found, seed)
        return _doubted(made, frame, source, calibration, deep(made, source, target, alignment))
    found = against(found, membrane)
    times = contradiction(found, membrane.contact & physical.known)
    if times > _CONTRADICTED:
        note = (
            f"the network is {times:.0f} times farther than it expects from what was felt: the physical render answers"
        )
        return replace(physical, notes=(*physical.notes, note))
    found = held_back(found, physical.known, params.caution, trust(network))
    return corrected(physical, target, found, seed, _unsure(source, target, network))


def _unsure(source: SensorSpec, target: SensorSpec, network: nn.Module) -> Unsure:
    """Where edges may be that a source told whose pixels are wider than the working grid's."""
    wide_mm = source.pixel_mm if source.pixel_mm > view_to_touch.COARSER[target.kind] * target.pixel_mm else 0.0
    blur_px, reach_px = cast("float", network.blur_px), cast("float", network.reach_px)
    return Unsure(blur_mm=wide_mm * blur_px, reach_mm=wide_mm * reach_px)


def _doubted(
    touch: Touch, frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, also: tuple[Doubt, ...]
) -> Touch:
    """A touch that no depth lies behind, with what speaks against the source's picture, and against it `also`."""
    return replace(touch, notes=(*depth.odd(frame, source, calibration), *also, *touch.notes))


def _physical(*reads: Any) -> Touch:
    """The physical render by depth and view; the last few are kept, so that a dragged slider asks the network alone."""

    def rendered() -> Touch:
        made = by_physics(*reads)
        return made.output if isinstance(made, Skipped) else made

    return _rendered.of(content(reads[:-1]), rendered)


_rendered: Memo[str, Touch] = Memo(4)


def condition(frame: TactileFrame, source: SensorSpec, alignment: Alignment, target: SensorSpec) -> Floats:
    """(channels, rows, cols) on the working grid; see `picture_input.of_picture`."""
    eye = source.camera if frame.camera is None else frame.camera
    reference: Any = frame.reference
    if reference is None:
        reference = optics.untouched(source.seen_through(eye)) if source.kind == "gel" else source.rest_depth_mm
    if reference.shape != frame.image.shape:
        raise ShapeError(f"the untouched reading must have the shape {frame.image.shape}, got {reference.shape}")
    now, still = frame.image.astype(np.float32), reference.astype(np.float32)
    change = now - still if source.kind == "gel" else still - now
    return of_picture(change, eye, source, working(target), alignment)


def by_physics(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    params: stage.GenerateParams,
    progress: Progress = SILENT,
) -> Touch | Skipped:
    """The touch by depth, cloud, view and physical render, each as it comes."""
    plain = depth.DepthParams()
    exact = depth.untouched(frame, source, calibration, plain)
    if exact is not None:
        return Skipped(output=stage.at_rest(target), why=stage.NO_CONTACT)
    felt = _felt(frame, source, calibration, Share(progress, 0.0, 0.5))
    cloud = adaptation.without_contact(felt, alignment, adaptation.AdaptParams())
    if cloud is None:
        cloud = adaptation.adapt(felt, alignment, adaptation.AdaptParams())
    view = projection.project(cloud, target, projection.ProjectParams())
    made = stage.generate(view, target, params, Share(progress, 0.6, 0.4))
    return replace(made, notes=(*doubts((*felt.notes, *view.notes)), *made.notes))


def _felt(frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, progress: Progress) -> DepthMap:
    reads = depth_network.weights(source, source, None)
    if isinstance(reads, NoWeights):
        return depth.recorded(frame, source, calibration, depth.DepthParams(), progress)
    return depth_network.depth(frame, source, calibration, building.ready(reads), NetworkParams(), progress)


BY_PHYSICS = Method(
    slot="touch",
    name="physics_from_frame",
    title="Physical render",
    help="depth, cloud, view and render in one",
    run=by_physics,
    params=stage.GenerateParams,
    reads=READS,
)
