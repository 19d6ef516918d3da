"""Compiled choice of one of many numbers by its rank (`ranks`)."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import inline_kernel, kernel


@kernel()
def select_rank(bits, where, rank, keys, counts):
    """Put in front of `keys` the number of this rank, 0 the least, of those in `where` (n,), and the next one.

    bits (n,) uint32: of single precision, none of them NaN. They are made to order as the numbers do and counted by
    their first eleven, of those that agree by the next eleven, and by the last ten. Past the last one the next is the
    last. keys (at least n and 2,) uint32 and counts (2048,) int64: written over.
    """
    counts[:] = 0
    for i in range(bits.shape[0]):
        n = np.uint64(i)
        keys[n] = _ordered(bits[n])
        counts[np.uint64(keys[n] >> np.uint32(21))] += np.int64(where[n])
    bin_, rank = _bin_of(counts, rank)
    # The least that lies in a later bin, should the next number be none of this one.
    most, kept = np.uint32(0xFFFFFFFF), 0
    beyond = most
    for i in range(bits.shape[0]):
        n = np.uint64(i)
        if where[n]:
            own = np.int64(keys[n] >> np.uint32(21))
            if own == bin_:
                keys[kept] = keys[n]
                kept += 1
            elif own > bin_ and keys[n] < beyond:
                beyond = keys[n]
    for shift, mask in ((10, 2047), (0, 1023)):
        counts[:] = 0
        for i in range(kept):
            counts[(np.int64(keys[i]) >> shift) & mask] += 1
        bin_, rank = _bin_of(counts, rank)
        all_, kept = kept, 0
        for i in range(all_):
            own = (np.int64(keys[i]) >> shift) & mask
            if own == bin_:
                keys[kept] = keys[i]
                kept += 1
            elif own > bin_ and keys[i] < beyond:
                beyond = keys[i]
    keys[1] = _ordered_back(keys[0] if rank + 1 < kept or beyond == most else beyond)
    keys[0] = _ordered_back(keys[0])


@inline_kernel()
def _bin_of(counts, rank):
    """The bin in which a rank lies, and the rank in it."""
    b = 0
    while rank >= counts[b]:
        rank -= counts[b]
        b += 1
    return b, rank


@inline_kernel()
def _ordered(bits):
    return np.uint32(bits ^ np.uint32(0xFFFFFFFF if bits >> np.uint32(31) else 0x80000000))


@inline_kernel()
def _ordered_back(key):
    return np.uint32(key ^ np.uint32(0x80000000 if key >> np.uint32(31) else 0xFFFFFFFF))
