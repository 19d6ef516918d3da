"""A network as the bytes of an ONNX file, written field by field: what OpenCV reads, without a library that exports it.

ONNX is a message of protobuf (github.com/onnx/onnx, `onnx.proto`): the numbers below are those of its fields.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_IR_VERSION, _OPERATORS = 8, 13
_FLOAT, _LONG = 1, 7  # kinds of tensor
_INT, _WORD, _INTS = 2, 3, 7  # kinds of attribute
_WIRE_BYTES = 2
_LOW_BITS, _MORE = 127, 128


class OnnxFile:
    """Operators one after the other; what comes out of one is named, and goes into others under that name."""

    INPUT = "picture"

    def __init__(self) -> None:
        self._nodes: list[bytes] = []
        self._constants: list[bytes] = []

    def add_constant(self, numbers: NDArray[np.float32] | NDArray[np.int64]) -> str:
        """Numbers that were learned, or sizes."""
        name = f"constant {len(self._constants)}"
        kind = _FLOAT if numbers.dtype == np.float32 else _LONG
        shape = b"".join(_number(1, n) for n in numbers.shape)
        content = np.ascontiguousarray(numbers).tobytes()
        self._constants.append(shape + _number(2, kind) + _field(8, name) + _field(9, content))
        return name

    def add_node(self, operator: str, inputs: Sequence[str], **how: int | str | list[int]) -> str:
        """The name of what an operator makes of its inputs; one that is not given is ""."""
        output = f"value {len(self._nodes)}"
        ends = b"".join(_field(1, name) for name in inputs) + _field(2, output)
        told = b"".join(_field(5, _attribute(name, value)) for name, value in how.items())
        self._nodes.append(ends + _field(3, output) + _field(4, operator) + told)
        return output

    def serialise(self, shape: tuple[int, ...], output: str, output_shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """The whole file for a picture of that shape (1, channels, rows, cols) in, and `output` out."""
        graph = b"".join(_field(1, node) for node in self._nodes) + _field(2, "network")
        graph += b"".join(_field(5, constant) for constant in self._constants)
        graph += _field(11, _value(self.INPUT, shape)) + _field(12, _value(output, output_shape))
        operators = _field(8, _field(1, "") + _number(2, _OPERATORS))
        return np.frombuffer(_number(1, _IR_VERSION) + operators + _field(7, graph), np.uint8)


def _attribute(name: str, value: int | str | list[int]) -> bytes:
    if isinstance(value, int):
        return _field(1, name) + _number(3, value) + _number(20, _INT)
    if isinstance(value, str):
        return _field(1, name) + _field(4, value) + _number(20, _WORD)
    return _field(1, name) + b"".join(_number(8, v) for v in value) + _number(20, _INTS)


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    sizes = b"".join(_field(1, _number(1, n)) for n in shape)
    return _field(1, name) + _field(2, _field(1, _number(1, _FLOAT) + _field(2, sizes)))


def _number(at: int, value: int) -> bytes:
    return _varint(at << 3) + _varint(value)


def _field(at: int, content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return _varint(at << 3 | _WIRE_BYTES) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    parts = bytearray()
    while value > _LOW_BITS:
        parts.append(value & _LOW_BITS | _MORE)
        value >>= 7
    return bytes([*parts, value])
