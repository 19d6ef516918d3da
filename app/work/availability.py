"""Which parameters cannot act on what is open, and why."""

from collections.abc import Mapping

from pipeline.base.params import list_settings
from pipeline.base.progress import Progress, reading_reported_to
from pipeline.engine.graph import Method
from pipeline.networks.guidance import NO_CONDITION_DROPOUT
from pipeline.networks.weights import NoWeights, Weights
from pipeline.translation.translate import Translation


def explain_unavailable(opened: Translation, progress: Progress) -> Mapping[str, Mapping[str, str]]:
    """Method key -> parameter -> why it cannot act; reads the weights."""
    with reading_reported_to(progress):
        weights = opened.weights
    return {m.key: _explain(m, weights[m.weights_name]) for m in opened.methods if m.weights is not None}


def _explain(method: Method, weights: object) -> Mapping[str, str]:
    if isinstance(weights, NoWeights):
        settings = list_settings(method.params()).items()
        return {name: f"no network for this pair: {weights.why}" for name, (_, setting) in settings if setting.pinned}
    has_dropout = not isinstance(weights, Weights) or weights.trained_with_condition_dropout
    return {} if has_dropout else {"guidance": NO_CONDITION_DROPOUT}
