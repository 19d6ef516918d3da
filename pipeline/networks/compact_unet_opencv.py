"""The compact U-Net run by OpenCV: the same answers as by torch to a millionth of them, without loading torch.

Torch takes 200 MB and two seconds before the first answer; OpenCV is loaded anyway. Normalising is part of
the convolution before it, and the folding of pixels into channels is numpy's.
"""

from __future__ import annotations

import threading
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats
from pipeline.base.memo import Memo
from pipeline.networks.onnx_file import OnnxFile
from pipeline.networks.weights import Weights

_EPSILON = 1e-5  # of torch's batch normalisation
_MOST_SIZES = 4  # of pictures that it is kept ready for
_MOST_BYTES = 1 << 30


class CompactUnetOpenCv:
    """Fields (outputs, rows, cols) of a picture (inputs, rows, cols), float32; threads may share it."""

    def __init__(
        self, weights: Weights, *, inputs: int, outputs: int, base_channels: int = 32, levels: int = 4, max_channels: int = 120,
        fold: int = 2,
    ) -> None:  # fmt: skip
        """`CompactUnet`'s own arguments; raises ValueError where the tensors do not fit them."""
        widths = [min(base_channels * 2**level, max_channels) for level in range(levels)]
        self.inputs, self.outputs, self.fold, self._levels = inputs, outputs, fold, levels
        self._tensors = weights.tensors
        self._check(widths)
        self._nets: Memo[tuple[int, int], Any] = Memo(_MOST_SIZES, most_bytes=_MOST_BYTES)
        self._one_at_a_time = threading.Lock()  # a net holds its input

    def __call__(self, picture: Floats) -> Floats:
        """What the network says of a picture."""
        rows, cols = picture.shape[1:]
        folded = _folded(np.asarray(picture, np.float32), self.fold)
        with self._one_at_a_time:
            net = self._nets.get_or_make(folded.shape[1:], lambda: self._built(*folded.shape[1:]))
            net.setInput(folded[None])
            said = _unfolded(net.forward()[0], self.fold)[:, :rows, :cols]
            return np.array(said, np.float32)  # a copy: the net writes into its own next time

    def _check(self, widths: list[int]) -> None:
        """Raise ValueError for tensors of another network."""
        pixels = self.fold * self.fold
        ends = [("start", self.inputs * pixels, widths[0])]
        wanted = _plain("finish", widths[0], self.outputs * pixels, 3)
        for level, (narrow, wide) in enumerate(pairwise(widths)):
            ends += [(f"down.{level}.0", narrow, wide), (f"down.{level}.1", wide, wide)]
            ends += [(f"merge.{level}.{k}", narrow, narrow) for k in range(2)]
            wanted |= _plain(f"thin.{level}", wide, narrow, 1)
        for name, inputs, outputs in ends:
            wanted[f"{name}.0.weight"] = (outputs, inputs, 3, 3)
            wanted |= {f"{name}.1.{part}": (outputs,) for part in ("weight", "bias", "running_mean", "running_var")}
            wanted[f"{name}.1.num_batches_tracked"] = ()
        wrong = wanted.keys() ^ self._tensors.keys()
        wrong |= {n for n, shape in wanted.items() if n not in wrong and self._tensors[n].shape != shape}
        if wrong:
            some = ", ".join(repr(name) for name in sorted(wrong)[:2])
            raise ValueError(f"{len(wrong)} tensors are missing, too many or of another shape, such as {some}")

    def _built(self, rows: int, cols: int) -> Any:
        """The network for folded pictures of that size."""
        import cv2

        file, sizes = OnnxFile(), [(rows, cols)]
        seen = [self._block(file, OnnxFile.INPUT, "start")]
        for level in range(self._levels - 1):
            half = file.add_node("MaxPool", [seen[-1]], kernel_shape=[2, 2], strides=[2, 2], ceil_mode=1)
            sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
            seen.append(self._block(file, self._block(file, half, f"down.{level}.0"), f"down.{level}.1"))
        field = seen.pop()
        for level in reversed(range(self._levels - 1)):
            thin = self._convolved(file, field, f"thin.{level}")
            shape = np.array([1, len(self._tensors[f"thin.{level}.bias"]), *sizes[level]], np.int64)
            how = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
            large = file.add_node("Resize", [thin, "", "", file.add_constant(shape)], **how)
            field = file.add_node("Add", [seen.pop(), large])
            field = self._block(file, self._block(file, field, f"merge.{level}.0"), f"merge.{level}.1")
        pixels = self.fold * self.fold
        output = self._convolved(file, field, "finish")
        content = file.serialise((1, self.inputs * pixels, rows, cols), output, (1, self.outputs * pixels, rows, cols))
        return cv2.dnn.readNetFromONNX(content, cv2.dnn.ENGINE_CLASSIC)

    def _block(self, file: OnnxFile, value: str, name: str) -> str:
        """A convolution with what normalises it, and its positive part."""
        norm = {part: self._tensors[f"{name}.1.{part}"] for part in ("weight", "bias", "running_mean", "running_var")}
        times = norm["weight"] / np.sqrt(norm["running_var"] + np.float32(_EPSILON))
        weight = self._tensors[f"{name}.0.weight"] * times[:, None, None, None]
        return file.add_node("Relu", [_convolution(file, value, weight, norm["bias"] - norm["running_mean"] * times)])

    def _convolved(self, file: OnnxFile, value: str, name: str) -> str:
        return _convolution(file, value, self._tensors[f"{name}.weight"], self._tensors[f"{name}.bias"])


def _plain(name: str, inputs: int, outputs: int, side: int) -> dict[str, tuple[int, ...]]:
    return {f"{name}.weight": (outputs, inputs, side, side), f"{name}.bias": (outputs,)}


def _convolution(file: OnnxFile, value: str, weight: NDArray[np.floating], bias: NDArray[np.floating]) -> str:
    side = weight.shape[-1]
    inputs = [value, file.add_constant(weight.astype(np.float32)), file.add_constant(bias.astype(np.float32))]
    return file.add_node("Conv", inputs, kernel_shape=[side, side], pads=[side // 2] * 4, strides=[1, 1], group=1)


def _folded(picture: Floats, fold: int) -> Floats:
    """Patches of `fold` x `fold` pixels as channels; the edge is repeated where they do not come out even."""
    rows, cols = picture.shape[1:]
    more = ((0, 0), (0, -rows % fold), (0, -cols % fold))
    whole = np.pad(picture, more, mode="edge") if rows % fold or cols % fold else picture
    channels, rows, cols = whole.shape
    parts = whole.reshape(channels, rows // fold, fold, cols // fold, fold).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(parts.reshape(channels * fold * fold, rows // fold, cols // fold))


def _unfolded(fields: Floats, fold: int) -> Floats:
    channels, rows, cols = len(fields) // (fold * fold), *fields.shape[1:]
    parts = fields.reshape(channels, fold, fold, rows, cols).transpose(0, 3, 1, 4, 2)
    return parts.reshape(channels, rows * fold, cols * fold)
