# pyright: basic
"""Compiled loops of the surface mode: the source grid, and which of its quads are worth a look.

Most quads of a fine source lie between the pixel centres of a coarse target. They are told apart for the whole grid at
once, on vectors, before any triangle is made. Further tuples, beside those of `project_kernels`:

    corners  what triangles hang on, the points by source pixel and then room for what the rim of a touch adds (m of
             them): x, y, z of the points in turn, mm, and apart those of the room; u and v where each is seen, px; 1/z;
             the pixel centres that u and v lie between, see `between`; and, of the room, the point that it begins at
    cells    source pixels with an empty one all round (rows, cols): the corner there, NONE = none; THERE
             and UNSEEN; between which centres, both in one number; what is to be done with the quad whose upper left
             corner this is, see `tell_apart`
"""

from __future__ import annotations

import numpy as np

from pipeline.base.kept_kernels import kernel
from pipeline.stages.project.project_kernels import pixel_of

SLACK = 1e-9  # barycentric and px: neighbours share the pixels on their common edge, so that no crack opens
NONE = np.uint32(0xFFFFFFFF)  # no point
THERE, UNSEEN = 1, 2  # bits of a corner: a point, and one behind the lens or not finite
EVEN, LOW = np.int64(1 << 32 | 1), np.int64((1 << 32) - 1)  # of two places in one number
JOINED, LOOK, RIM, BEHIND = 1, 2, 4, 8  # bits of a quad: three corners or more, a centre near them; see `tell_apart`


@kernel(error_model="numpy")
def between(u, size):
    """The pixel centres that a coordinate lies between, as first not before + last not after.

    That sum is even on a centre, to the slack, and odd between two: half of it, rounded up and down, gives them back.
    Clamped as floats to between two centres outside the image.
    """
    near = u if u > -1.5 else -1.5
    near = near if near < size + 0.5 else size + 0.5
    return np.int32(np.ceil(near - SLACK)) + np.int32(np.floor(near + SLACK))


@kernel(error_model="numpy")
def see(lens, corners, state, pixel):
    """Write where points are seen, and which are; anything, harmlessly, for the others. Returns as `to_pixels`."""
    flat, _, u, v, w, across, down, _ = corners
    _, _, _, _, rows, cols, behind = lens
    inside = 0
    for i in range(state.shape[0]):
        x, y, z = np.float64(flat[3 * i]), np.float64(flat[3 * i + 1]), np.float64(flat[3 * i + 2])
        u[i], v[i], w[i], pixel[i] = pixel_of(x, y, z, lens)
        inside += pixel[i] >= 0
        ok = (z > behind) & (z < np.inf) & (abs(x) < np.inf) & (abs(y) < np.inf)
        state[i] = np.uint8(THERE if ok else THERE | UNSEEN)
    for i in range(state.shape[0]):
        across[i] = between(u[i], cols)
    for i in range(state.shape[0]):
        down[i] = between(v[i], rows)
    return inside


@kernel(error_model="numpy")
def neighbour_distances(flat, index, stride, every, behind, squares):
    """Write the distances, squared, of every `every`-th pair of points that are neighbours in a row; how many."""
    n = 0
    for i in range(0, index.shape[0] - 1, every):
        p = 3 * i
        near = flat[p + 2] > behind and flat[p + 5] > behind and index[i + 1] - index[i] == stride
        dx, dy = np.float64(flat[p]) - flat[p + 3], np.float64(flat[p + 1]) - flat[p + 4]
        dz = np.float64(flat[p + 2]) - flat[p + 5]
        square = dx * dx + dy * dy + dz * dz
        if near and square < np.inf and n < squares.shape[0]:
            squares[n] = square
            n += 1
    return n


@kernel(error_model="numpy")
def place(index, starts, bounds, stride, state, corners, cells, alone):
    """Put every corner in its cell of the flat `cells`.

    `starts` are where each source row begins in the points, `bounds` the first source row and column, the columns of
    the source and those of the cells. Of several points of one source pixel the last stays; the others stand `alone`,
    as do those between the rows and columns that a stride looks at.
    """
    top, left, grid_cols, cols = bounds
    _, _, _, _, _, across, down, _ = corners
    corner, state_at, centres_at, _ = cells
    for r in range(starts.shape[0] - 1):
        begin, end = starts[r], starts[r + 1]
        first = (top + r) * grid_cols + left
        g = ((top + r) // stride - top // stride + 1) * cols + 1
        gaps = 0
        for i in range(begin, end - 1):
            gaps += index[i + 1] - index[i] != 1
        if stride == 1 and gaps == 0 and begin < end:  # most rows: on vectors
            # Unsigned places, which cannot count from an array's end: numba's checks for that keep vectors away.
            n, to, of = np.uint64(end - begin), np.uint64(g + index[begin] - first), np.uint64(begin)
            for k in range(n):
                corner[to + k] = of + k
            for k in range(n):
                state_at[to + k] = state[of + k]
            for k in range(n):
                centres_at[to + k] = (np.int64(down[of + k]) << 32) ^ np.int64(across[of + k])
            continue
        for i in range(begin, end):
            column = index[i] - first
            apart = stride > 1 and ((top + r) % stride != 0 or (left + column) % stride != 0)
            if apart or (i + 1 < end and index[i + 1] == index[i]):
                alone[i] = True
                continue
            at = g + ((left + column) // stride - left // stride if stride > 1 else column)
            corner[at] = i
            state_at[at] = state[i]
            centres_at[at] = (np.int64(down[i]) << 32) ^ np.int64(across[i])


@kernel(error_model="numpy")
def tell_apart(cells, todo, late):
    """Say of each quad what is to be done with it, and list those that want a look, row by row.

    JOINED: three corners or more are there. LOOK: these, all of them seen, and a pixel centre may lie in their box.
    BEHIND: not all of them are seen. RIM: some corners are there, all of them seen, and others are not.

    A box holds no centre if all four lie between the same two, in x or in y; what an absent corner left behind may
    widen it, which costs a look and no more. All of it in bits, on vectors.

    An entry of `todo` is twice the quad, plus one for its rim, which comes after the row's quads. Returns how many
    entries there are, and how many quads reach behind the lens.
    """
    _, state, centres, quad = cells
    rows, cols = quad.shape
    n, n_behind = 0, 0
    for r in range(rows - 1):
        for c in range(cols - 1):
            a = centres[r, c]
            mixed = (a ^ centres[r, c + 1]) | (a ^ centres[r + 1, c]) | (a ^ centres[r + 1, c + 1]) | (~a & EVEN)
            quad[r, c] = np.uint8(LOOK if ((mixed & LOW) != 0) & ((mixed & ~LOW) != 0) else 0)
        for c in range(cols - 1):
            i, j, k, m = state[r, c], state[r, c + 1], state[r + 1, c], state[r + 1, c + 1]
            three = ((i & j & (k | m)) | (k & m & (i | j))) & THERE
            some, every = i | j | k | m, i & j & k & m
            unseen = (some & UNSEEN) >> 1
            seen = np.uint8(unseen ^ 1)
            joined = three | (three * quad[r, c] * seen) | (three * unseen * BEHIND)
            quad[r, c] = np.uint8(joined | ((some & ~every & seen) * RIM))
        m = 0
        for c in range(cols - 1):  # no branch: which quads hold a centre is beyond guessing
            todo[n] = 2 * (r * cols + c)
            n += (quad[r, c] & LOOK) >> 1
            late[m] = 2 * (r * cols + c) + 1
            m += (quad[r, c] & RIM) >> 2
        for c in range(cols - 1):
            n_behind += (quad[r, c] & BEHIND) >> 3
        for c in range(m):
            todo[n + c] = late[c]
        n += m
    return n, n_behind


@kernel(error_model="numpy")
def find_lonely(cells, alone):
    """Set in `alone` the points without neighbours to form a triangle with, drawn or not."""
    corner, state, _, quad = cells
    rows, cols = quad.shape
    lonely = False
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            joined = (quad[r, c] | quad[r, c - 1] | quad[r - 1, c] | quad[r - 1, c - 1]) & JOINED
            lonely |= (state[r, c] != 0) & (joined == 0)
    if lonely:
        for r in range(1, rows - 1):
            for c in range(1, cols - 1):
                joined = (quad[r, c] | quad[r, c - 1] | quad[r - 1, c] | quad[r - 1, c - 1]) & JOINED
                if state[r, c] != 0 and joined == 0:
                    alone[corner[r, c]] = True
