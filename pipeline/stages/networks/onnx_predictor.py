"""A network run by OpenCV from its ONNX file: the values of torch to 1e-5, without loading torch.

And its export.

Torch takes 200 MB and two seconds before its first answer; OpenCV is loaded anyway.

The first pass of a residual denoiser without torch: the posterior mean, which is all that one
step needs.
"""

from __future__ import annotations

import io
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.stages.networks.weights import Weights

if TYPE_CHECKING:
    from torch import nn


_OPSET = 17  # ONNX operators that OpenCV 5 reads
_MAX_FOLD = 1024
# (rows, cols) of the example that is traced where the exported file serves any size
_EXAMPLE_SIZE = 96, 128


class OnnxPredictor:
    """The outputs of a network for one image; may be shared by threads."""

    def __init__(self, content: bytes, *, fold: int = 1) -> None:
        """`content`: an ONNX file of `export_onnx`.

        `fold`: rows and cols of its input must be multiples of it.

        Raises ValueError for a file that OpenCV cannot read or that names other files.
        """
        import cv2

        if not 1 <= fold <= _MAX_FOLD:
            raise ValueError(f"their fold is {fold}")
        if b"location" in content:  # key of ONNX's external data
            raise ValueError("their ONNX graph names other files")
        try:
            self._net = cv2.dnn.readNetFromONNX(
                np.frombuffer(content, np.uint8), cv2.dnn.ENGINE_CLASSIC
            )
        except cv2.error as error:
            raise ValueError("OpenCV cannot read their ONNX graph") from error
        self._names = sorted(self._net.getUnconnectedOutLayersNames())  # output_0, ...
        self._fold = fold
        self._lock = threading.Lock()  # the net holds its input

    def __call__(self, image: Floats) -> tuple[Floats, ...]:
        """Every output for an image (inputs, rows, cols) float32, without the batch axis: fields
        (..., rows, cols).
        """
        rows, cols = image.shape[1:]
        padding = ((0, 0), (0, -rows % self._fold), (0, -cols % self._fold))
        padded = np.pad(np.asarray(image, np.float32), padding, mode="edge")
        with self._lock:
            self._net.setInput(np.ascontiguousarray(padded)[None])
            # Copies, as OpenCV reuses its memory.
            outputs = tuple(
                np.array(output[0], np.float32) for output in self._net.forward(self._names)
            )
        return tuple(output[..., :rows, :cols] if output.ndim > 1 else output for output in outputs)


def export_onnx(network: Any, n_channels: int) -> bytes:
    """An ONNX file of a torch network whose input has `n_channels` channels.

    The input is (1, n_channels, rows, cols); rows and cols are those of the network's `onnx_size`,
    or multiples of its `fold` where that is None.
    """
    import torch

    size = network.onnx_size
    image = torch.zeros(1, n_channels, *(size or _EXAMPLE_SIZE))
    file: Any = io.BytesIO()  # torch takes one, its types do not say so
    with warnings.catch_warnings(), torch.no_grad():
        outputs = network(image)
        names = [f"output_{i}" for i in range(len(outputs) if isinstance(outputs, tuple) else 1)]
        # of the tracer: what it treats as constant is constant here
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (image,),
            file,
            dynamo=False,
            opset_version=_OPSET,
            input_names=["image"],
            output_names=names,
            dynamic_axes=None if size else {"image": {2: "rows", 3: "cols"}},
        )
    return file.getvalue()


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
