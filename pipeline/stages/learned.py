"""Methods by network: what answers in their place where there are no weights, and that it says so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.base.errors import ModelMissing
from pipeline.engine.graph import Instead, Method
from pipeline.networks import building


def learned(run: Callable[..., Any], instead: Method) -> Callable[..., Any]:
    """A method's function that reads weights last: `run` (*reads, network, params, progress) answers by the network.

    Where the weights are missing or do not fit, `instead`, which reads the same without them, answers, and the result
    says why. Parameters that are not its own leave it on its defaults.
    """

    def answer(*args: Any) -> Any:
        *reads, weights, params, progress = args
        try:
            ready = building.ready(weights)
        except ModelMissing as problem:
            told = params if isinstance(params, instead.params) else instead.params()
            return Instead(
                answer=instead.run(*reads, told, progress), why=f"{problem}; {instead.title.lower()} answers instead"
            )
        return run(*reads, ready, params, progress)

    return answer
