"""The first pass of a residual denoiser without torch: the posterior mean, which is all that one
step needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, TypeAlias

from pipeline.core.arrays import Floats
from pipeline.stages.networks.onnx_predictor import OnnxPredictor
from pipeline.stages.networks.weights import Weights

if TYPE_CHECKING:
    from torch import nn

FIELD_LIMIT = 8.0  # units; clean fields are clipped to it


@dataclass(kw_only=True)
class ResidualConstants:
    """Constants of a `residual_denoiser`, which explains them."""

    inputs: float = 0.0  # channels of the condition
    unit_mm: float = 1.0
    sigma_max: float = 200.0
    sigma_min: float = 0.02
    noise_correlation: float = 0.0
    error_factor_in_view: float = 1.0
    error_factor_outside: float = 1.0
    error_exponent: float = 1.0
    trained_on_recordings: float = 0.0  # 0 or 1

    @property
    def error_factors(self) -> tuple[float, float]:
        """Factors of the predicted error inside and outside the source's contact."""
        return self.error_factor_in_view, self.error_factor_outside


class FirstPassPredictor(ResidualConstants):
    """A residual denoiser of weights with an ONNX file; torch is loaded only by `load_network`."""

    def __init__(self, weights: Weights, load: Callable[[Weights], nn.Module]) -> None:
        """`load` makes the whole network. Raises ValueError for a file that OpenCV cannot read."""
        names = {field.name for field in fields(ResidualConstants)}
        super().__init__(
            **{name: float(value) for name, value in weights.config.items() if name in names}
        )
        self._weights = weights
        self._load = load
        self._predict = OnnxPredictor(weights.read_onnx(), fold=int(weights.config.get("fold", 2)))

    def predict(self, condition: Floats) -> tuple[Floats, Floats]:
        """The clean field (2, rows, cols) and the log of its expected error (rows, cols) of a
        condition.
        """
        output = self._predict(condition)[0]
        return output[:2].clip(-FIELD_LIMIT, FIELD_LIMIT), output[2]

    def load_network(self) -> nn.Module:
        """The whole network, for more than one step."""
        return self._load(self._weights)


# what `network_factory.load_predictor` returns
ResidualNetwork: TypeAlias = "nn.Module | FirstPassPredictor"
