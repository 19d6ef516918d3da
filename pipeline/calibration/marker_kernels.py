"""Compiled filling of what markers hide (`markers`)."""
# pyright: basic

from pipeline.core.cached_kernels import kernel


@kernel()
def fill_by_means(out, means, weight, least, hidden):
    """Fill the hidden pixels of `out` (rows, cols, channels) where a mean weighs more than `least`.

    Return if any stay.

    means: sums around each pixel, of the shape of `out`; weight (rows, cols): of each sum. hidden
    (rows, cols) is cleared where a pixel is filled.
    """
    rows, cols, channels = out.shape
    is_left = False
    for r in range(rows):
        for c in range(cols):
            if hidden[r, c]:
                if weight[r, c] > least:
                    for k in range(channels):
                        out[r, c, k] = means[r, c, k] / weight[r, c]
                    hidden[r, c] = False
                else:
                    is_left = True
    return is_left
