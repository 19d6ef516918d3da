"""Force of a frame as quantities that need no truth, in newtons once two presses of the unit
were weighed.
"""

import math

from pipeline.core.graph import StageResults
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.physics.contact_force import ContactForce
from pipeline.stages.depth.contact_force import FORCE as FORCE_METHOD
from pipeline.stages.depth.contact_force import FORCE_MODELS
from pipeline.stages.metrics.stage_metrics import (
    FORCE,
    SHEAR,
    SHEAR_DIRECTION,
    TRUE_FORCE,
    TRUE_SHEAR,
    UNCALIBRATED_FORCE,
    UNCALIBRATED_SHEAR,
)
from pipeline.translation.translate import Translation


def estimate_force(depth: DepthMap, frame: TactileFrame, translation: Translation) -> ContactForce:
    """Force that the contact model gives for a depth map of the source, without a scale."""
    inputs = {"depth": depth, "source": translation.source, "frame": frame}
    stage = FORCE_METHOD.stage
    return (
        translation.graph.with_methods((FORCE_METHOD,)).evaluate((stage,), inputs, {})[stage].output
    )


def measure_force(results: StageResults, index: int, translation: Translation) -> dict[str, float]:
    """The force of a frame's depth as metrics, and the true one where known.

    {} without depth or certain contact.

    Without a force scale the metrics are others, whose titles say that their scale is not known.
    Shear takes the scale of the normal force, since both are proportional to the gel's stiffness.
    """
    depth = results["depth"].output if "depth" in results else None
    names = list_force_metrics(translation)
    if not isinstance(depth, DepthMap) or not names or depth.is_uncertain:
        return {}
    found = estimate_force(depth, translation.stream.frame(index), translation)
    normal_n = found.normal_n
    scale = translation.force_scale
    figures = {names[0]: normal_n if scale is None else scale.apply(normal_n)}
    truth = translation.read_source_truth(index)
    true_n = None if truth is None else truth.force_n
    if true_n is not None:
        figures[TRUE_FORCE] = -float(true_n[2])
    if found.shear_n is not None:
        right_n, down_n = found.shear_n
        figures[names[1]] = math.hypot(right_n, down_n) * (
            figures[names[0]] / normal_n if normal_n > 0 else 1.0
        )
        if figures[names[1]] > 0:
            figures[SHEAR_DIRECTION] = math.degrees(math.atan2(down_n, right_n))
        if true_n is not None:
            figures[TRUE_SHEAR] = math.hypot(float(true_n[0]), float(true_n[1]))
    return figures


def list_force_metrics(translation: Translation) -> tuple[str, ...]:
    """The metrics of the source's normal force and, on a gel with markers, of its shear.

    Empty on a route without depth, or for a kind without contact model.
    """
    if (
        "depth" not in translation.stages
        or FORCE_MODELS.get(translation.source.sensor_kind) is None
    ):
        return ()
    names = (
        (UNCALIBRATED_FORCE, UNCALIBRATED_SHEAR)
        if translation.force_scale is None
        else (FORCE, SHEAR)
    )
    return names if translation.source.markers is not None else names[:1]
