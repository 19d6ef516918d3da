"""Normal force of a frame as a quantity that needs no truth, in newtons once two presses of the unit were weighed."""

from collections.abc import Mapping

from pipeline.engine.graph import Graph, StageResult
from pipeline.metrics.stage_metrics import FORCE as FORCE_METRIC
from pipeline.metrics.stage_metrics import TRUE_FORCE, UNCALIBRATED_FORCE
from pipeline.stages.depth.contact_force import FORCE
from pipeline.translation.translate import Translation
from pipeline.values.frames import Truth
from pipeline.values.results import DepthMap


def estimate_force(depth: DepthMap, translation: Translation, graph: Graph) -> float:
    """Force in N that the contact model gives for a depth map of the source; cached by `graph`."""
    inputs = {"depth": depth, "source": translation.source}
    return graph.with_methods((FORCE,)).evaluate((FORCE.stage,), inputs, {})[FORCE.stage].output.estimated_n


def measure_force(
    results: Mapping[str, StageResult], translation: Translation, graph: Graph, truth: Truth | None
) -> dict[str, float]:
    """The force of a frame's depth as a metric, and the true one where known; {} on a route without depth.

    Without a force scale the metric is another one, whose title says that its scale is not known.
    """
    depth = results["depth"].output if "depth" in results else None
    if not isinstance(depth, DepthMap):
        return {}
    name = select_force_metric(translation)
    if not name:
        return {}
    estimated_n, scale = estimate_force(depth, translation, graph), translation.force_scale
    figures = {name: estimated_n if scale is None else scale.apply(estimated_n)}
    if truth is not None and truth.force_n is not None:
        figures[TRUE_FORCE] = -float(truth.force_n[2])
    return figures


def select_force_metric(translation: Translation) -> str:
    """The metric that holds the source's force; "" on a route without depth, or for a kind without contact model."""
    if "depth" not in translation.stages or not translation.source.sensor_kind.force_estimator:
        return ""
    return UNCALIBRATED_FORCE if translation.force_scale is None else FORCE_METRIC
