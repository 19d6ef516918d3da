"""Methods by network: what answers in their place where there are no weights, and that it says so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.base.errors import ModelMissing
from pipeline.engine.graph import Fallback, Method
from pipeline.networks import network_factory


def fall_back_without_weights(run: Callable[..., Any], fallback: Method) -> Callable[..., Any]:
    """A method's function that reads weights last: `run` (*reads, network, params, progress) answers by the network.

    Where the weights are missing or do not fit, `instead`, which reads the same without them, answers, and the result
    says why. Parameters that are not its own leave it on its defaults.
    """

    def run_or_fall_back(*args: Any) -> Any:
        *reads, weights, params, progress = args
        try:
            ready = network_factory.load_predictor(weights)
        except ModelMissing as problem:
            told = params if isinstance(params, fallback.params) else fallback.params()
            return Fallback(
                result=fallback.run(*reads, told, progress),
                reason=f"{problem}; {fallback.title.lower()} answers instead",
            )
        return run(*reads, ready, params, progress)

    return run_or_fall_back
