"""Export of a torch network to an ONNX file, from which OpenCV answers without torch (`onnx_predictor`)."""

import io
import warnings
from typing import Any

_OPSET = 17  # ONNX operators that OpenCV 5 reads
_EXAMPLE_SIZE = 96, 128  # (rows, cols) of the example that is traced where the exported file serves any size


def export_onnx(network: Any, n_channels: int) -> bytes:
    """An ONNX file of a torch network whose input has `n_channels` channels.

    The input is (1, n_channels, rows, cols); rows and cols are those of the network's `onnx_size`, or multiples of its
    `fold` where that is None.
    """
    import torch

    size = network.onnx_size
    image = torch.zeros(1, n_channels, *(size or _EXAMPLE_SIZE))
    file: Any = io.BytesIO()  # torch takes one, its types do not say so
    with warnings.catch_warnings(), torch.no_grad():
        outputs = network(image)
        names = [f"output_{i}" for i in range(len(outputs) if isinstance(outputs, tuple) else 1)]
        warnings.simplefilter("ignore")  # of the tracer: what it treats as constant is constant here
        torch.onnx.export(
            network, (image,), file, dynamo=False, opset_version=_OPSET, input_names=["image"],
            output_names=names,             dynamic_axes=None if size else {"image": {2: "rows", 3: "cols"}},
        )  # fmt: skip
    return file.getvalue()
