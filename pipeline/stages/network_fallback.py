"""Fallback of methods by network: another method computes the value where weights are missing, with the reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.base.errors import ModelMissing
from pipeline.engine.graph import Fallback, Method
from pipeline.networks import network_factory


def fall_back_without_weights(
    run: Callable[..., Any], fallback: Method, reason: str = "physics: no network for this pair"
) -> Callable[..., Any]:
    """Wrap `run` (*reads, network, params, progress) as a method's function whose last input is weights.

    Where the weights are missing or do not fit, `fallback`, which has the same inputs without weights, computes the
    value, and the result states `reason` and what is missing. Parameters of another class are replaced by the defaults
    of `fallback`.
    """

    def run_or_fall_back(*args: Any) -> Any:
        *reads, weights, params, progress = args
        try:
            network = network_factory.load_predictor(weights)
        except ModelMissing as problem:
            fallback_params = params if isinstance(params, fallback.params) else fallback.params()
            return Fallback(
                result=fallback.run(*reads, fallback_params, progress),
                reason=f"{reason}; {problem}",
            )
        return run(*reads, network, params, progress)

    return run_or_fall_back
