"""A network run by OpenCV from its ONNX file: the values of torch to 1e-5, without loading torch.

Torch takes 200 MB and two seconds before its first answer; OpenCV is loaded anyway.
"""

import threading

import numpy as np

from pipeline.base.arrays import Floats


class OnnxPredictor:
    """The outputs of a network for one image; may be shared by threads."""

    def __init__(self, content: bytes, *, fold: int = 1) -> None:
        """`content`: an ONNX file of `onnx_export`; `fold`: rows and cols of its input must be multiples of it.

        Raises ValueError for a file that OpenCV cannot read or that names other files.
        """
        import cv2

        if b"location" in content:  # key of ONNX's external data
            raise ValueError("their ONNX graph names other files")
        try:
            self._net = cv2.dnn.readNetFromONNX(np.frombuffer(content, np.uint8), cv2.dnn.ENGINE_CLASSIC)
        except cv2.error as error:
            raise ValueError("OpenCV cannot read their ONNX graph") from error
        self._names = sorted(self._net.getUnconnectedOutLayersNames())  # output_0, ...
        self._fold = fold
        self._lock = threading.Lock()  # the net holds its input

    def __call__(self, image: Floats) -> tuple[Floats, ...]:
        """Every output for an image (inputs, rows, cols) float32, without the batch axis: fields (..., rows, cols)."""
        rows, cols = image.shape[1:]
        padding = ((0, 0), (0, -rows % self._fold), (0, -cols % self._fold))
        padded = np.pad(np.asarray(image, np.float32), padding, mode="edge")
        with self._lock:
            self._net.setInput(np.ascontiguousarray(padded)[None])
            # Copies, as OpenCV reuses its memory.
            outputs = tuple(np.array(output[0], np.float32) for output in self._net.forward(self._names))
        return tuple(output[..., :rows, :cols] if output.ndim > 1 else output for output in outputs)
