"""A network run by OpenCV from its ONNX file: the values of torch to 1e-5, without loading torch.

And its export.

Torch takes 200 MB and two seconds before its first answer; OpenCV is loaded anyway.
"""

import io
import threading
import warnings
from typing import Any

import numpy as np

from pipeline.core.arrays import Floats

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
