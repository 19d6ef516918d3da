"""Fallback of methods by network: another method computes the value where weights are missing,
with the reason.
"""

from collections.abc import Callable
from typing import Any, TypeVar, TypeVarTuple, Unpack

from pipeline.core.errors import ModelMissing
from pipeline.core.graph import EarlyAnswer, Fallback, Method, Skipped
from pipeline.core.progress import Progress
from pipeline.stages.networks import network_factory
from pipeline.stages.networks.weights import NoWeights, Weights

Params = TypeVar("Params")
Output = TypeVar("Output")
Reads = TypeVarTuple("Reads")


def fall_back_without_weights(
    run: Callable[
        [Unpack[Reads], Any, Params, Progress], Output | Skipped[Output] | Fallback[Output]
    ],
    fallback: Method[Any, Output, *Reads],
    reason: str = "physics: no network for this pair",
) -> Callable[
    [Unpack[Reads], Weights | NoWeights, Params, Progress],
    Output | Skipped[Output] | Fallback[Output],
]:
    """Wrap `run` (*reads, network, params, progress) as a method's function whose last input is
    weights.

    Where the weights are missing or do not fit, `fallback`, which has the same inputs without
    weights, computes the value, and the result states `reason` and what is missing. Parameters of
    another class are replaced by the defaults of `fallback`.
    """

    def run_or_fall_back(
        *args: *tuple[*Reads, Weights | NoWeights, Params, Progress],
    ) -> Output | Skipped[Output] | Fallback[Output]:
        *_, weights, params, progress = args
        reads = args[:-3]
        try:
            network = network_factory.load_predictor(weights)
        except ModelMissing as problem:
            fallback_params = params if isinstance(params, fallback.params) else fallback.params()
            answer = fallback.run(*reads, fallback_params, progress)
            answer = answer.result if isinstance(answer, Fallback) else answer
            answer = answer.output if isinstance(answer, EarlyAnswer) else answer
            return Fallback(result=answer, reason=f"{reason}; {problem}")
        return run(*reads, network, params, progress)

    return run_or_fall_back
