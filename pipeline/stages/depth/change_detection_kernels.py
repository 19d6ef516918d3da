"""Compiled mean change of the blocks of two images (`change_detection`)."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import kernel


@kernel()
def compute_block_change(image, reference, block, total, out):
    """Write the mean absolute difference of every whole block, rounded half to even, into `out` (rows, cols, 3).

    image, reference (rows, 3 x cols) uint8. total (at least 3 x block x blocks across,) uint16: scratch.
    """
    tall, wide, colours = out.shape
    width = wide * block * colours
    whole = np.int32(block * block)
    for i in range(tall):
        for c in range(width):
            total[c] = np.uint16(0)
        for r in range(i * block, (i + 1) * block):
            for c in range(width):
                a, b = np.int16(image[r, c]), np.int16(reference[r, c])
                total[c] += np.uint16(abs(a - b))
        for j in range(wide):
            for k in range(colours):
                s = np.int32(0)
                for c in range(block):
                    s += np.int32(total[(j * block + c) * colours + k])
                mean, rest = s // whole, 2 * (s % whole)
                if rest > whole or (rest == whole and mean % 2 == 1):
                    mean += 1
                out[i, j, k] = np.uint8(mean)
