"""Round trip: the generated touch is translated back to the source, and compared with the depth it was made from.

It needs no ground truth, so that it ranks the frames of real recordings and of live sensors. It is small where both
directions keep the shape of the contact; it cannot see an error that the way back undoes, as of the alignment.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Graph, StageResult
from pipeline.geometry import rigid
from pipeline.metrics.familiarity import compute_training_distance
from pipeline.metrics.stage_metrics import ROUND_TRIP, TRAINING_DISTANCE, compute_mae_mm
from pipeline.sensors.alignment import Alignment
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, GeneratedTouch, TargetDepth

_BACK = "touch_depth"  # stage whose value on the way back is compared


def measure_training_distance(results: Mapping[str, StageResult], translation: Translation) -> dict[str, float]:
    """Return the distance of a touch from training as a metric of its frame; {} where it is unknown."""
    observed = results["target_depth"].output if "target_depth" in results else None
    if not isinstance(observed, TargetDepth):
        return {}
    distance = compute_training_distance(observed, translation.target)
    return {TRAINING_DISTANCE: distance} if np.isfinite(distance) else {}


def measure_round_trip(
    results: Mapping[str, StageResult],
    translation: Translation,
    graph: Graph,
    params: Mapping[str, object],
    progress: Progress = SILENT,
) -> dict[str, float]:
    """Return the round-trip error of a frame's results as a metric; {} without contact or on a route without depth.

    Compared are the pixels in contact that the target could see. The way back takes the methods and parameters of the
    way there, without the files that were given for one direction. Raises TouchError as the stages do.
    """
    depth, touch = (results[name].output if name in results else None for name in ("depth", "touch"))
    if not isinstance(depth, DepthMap) or not isinstance(touch, GeneratedTouch) or _BACK not in translation.stages:
        return {}
    if not depth.contact.any():
        return {}
    back = reverse_translation(translation, depth)
    reference = back.source.render_reference() if touch.reference is None else touch.reference
    frame = TactileFrame(
        sensor=back.source.name, image=touch.image, reference=reference, camera=touch.camera, origin="generated touch"
    )
    way_back = graph.with_methods(back.methods)
    returned = way_back.evaluate([_BACK, "target_depth"], back.build_inputs(frame, progress=progress), params, progress)
    membrane, view = returned[_BACK].output, returned["target_depth"].output
    if membrane.indentation_mm.shape != depth.indentation_mm.shape:
        return {}
    error_mm = compute_mae_mm(membrane.indentation_mm, depth.indentation_mm, depth.contact & view.in_view)
    return {ROUND_TRIP: error_mm} if np.isfinite(error_mm) else {}


def reverse_translation(translation: Translation, depth: DepthMap) -> Translation:
    """Return the translation from the target back to the source, onto the pixels of the source's `depth`."""
    alignment = Alignment(
        alignment_from_source=freeze(rigid.invert(translation.alignment.target_from_alignment)),
        target_from_alignment=freeze(rigid.invert(translation.alignment.alignment_from_source)),
    )
    return replace(
        translation, source=translation.target, target=translation.source.with_camera(depth.camera),
        alignment=alignment, calibration=None, mesh=None, symmetry=None, load_context_images=tuple,
        request=replace(translation.request, calibration=None, mesh=None, weights=()),
    )  # fmt: skip
