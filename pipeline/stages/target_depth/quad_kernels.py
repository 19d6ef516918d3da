# pyright: basic
"""Compiled loops of the surface mode: the source grid, and which of its quads can cover a target
pixel centre.

Most quads of a fine source lie between the pixel centres of a coarse target. They are rejected for
a strip of the grid at once, vectorised, before any triangle is made. Tuples in addition to those of
`projection_kernels`:

    corners  vertices of triangles, the points of a strip of the source followed by room for
             vertices of the rim: x, y, z of the points, mm; those of the rim, each with the point
             it starts from; pixel coordinates and 1/z (3, m); the pixel centres it lies between in
             x and y (2, m), see `bracket_pixel_centres`
    cells    source pixels of the strip, with an empty column on either side (rows, cols): the
             vertex, NO_POINT = none; PRESENT and NOT_VISIBLE; its bracketing centres in one number;
             the class of the quad whose upper left corner this is, see `classify_quads`
"""

from __future__ import annotations

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel

# barycentric and px: neighbours share pixels on their common edge, so that no crack opens
SLACK = 1e-9
NO_POINT = np.uint32(0xFFFFFFFF)  # no point
# bits of a vertex: a point; behind the lens or not finite
PRESENT = np.uint8(1)
NOT_VISIBLE = np.uint8(2)
# of two brackets in one number
PARITY_BITS = np.int64(1 << 32 | 1)
LOW_BITS = np.int64((1 << 32) - 1)
HAS_TRIANGLE, NEEDS_DRAWING, RIM, BEHIND = (
    np.uint8(bit) for bit in (1, 2, 4, 8)
)  # bits of a quad, see `classify_quads`


@inner_kernel()
def bracket_pixel_centres(u, size):
    """The pixel centres that a coordinate lies between, as first not before + last not after.

    The sum is even on a centre (within the slack) and odd between two: half of it, rounded up and
    down, gives both back. Clamped as floats to between two centres outside the image.
    """
    near = u if u > -1.5 else -1.5
    near = near if near < size + 0.5 else size + 0.5
    return np.int32(np.ceil(near - SLACK)) + np.int32(np.floor(near + SLACK))


@inner_kernel()
def project_corners(lens, n, corners, state):
    """Project the first `n` points and mark which are visible.

    The values of the others are arbitrary.
    """
    flat, _, screen, between_px = corners
    u = screen[0]
    v = screen[1]
    w = screen[2]
    across = between_px[0]
    down = between_px[1]
    fx, fy, cx, cy, rows, cols, behind = lens
    for i in range(n):
        x = np.float64(flat[3 * i])
        y = np.float64(flat[3 * i + 1])
        z = np.float64(flat[3 * i + 2])
        near = 1.0 / z
        u[i] = fx * x * near + cx
        v[i] = fy * y * near + cy
        w[i] = near
        ok = (z > behind) & (z < np.inf) & (abs(x) < np.inf) & (abs(y) < np.inf)
        state[i] = np.uint8(PRESENT if ok else PRESENT | NOT_VISIBLE)
    for i in range(n):
        across[i] = bracket_pixel_centres(u[i], cols)
    for i in range(n):
        down[i] = bracket_pixel_centres(v[i], rows)


@kernel()
def measure_neighbour_distances(flat, index, stride, every, behind, squares):
    """Write squared distances of every `every`-th pair of row neighbours; returns their number."""
    n = 0
    for i in range(0, index.shape[0] - 1, every):
        p = 3 * i
        near = flat[p + 2] > behind and flat[p + 5] > behind and index[i + 1] - index[i] == stride
        dx = np.float64(flat[p]) - flat[p + 3]
        dy = np.float64(flat[p + 1]) - flat[p + 4]
        dz = np.float64(flat[p + 2]) - flat[p + 5]
        square = dx * dx + dy * dy + dz * dz
        if near and square < np.inf and n < squares.shape[0]:
            squares[n] = square
            n += 1
    return n


@inner_kernel()
def place_corners(index, starts, bounds, strip, state, corners, cells, alone):
    """Put the vertices of a strip into its cells.

    `starts`: first point of each source row. `bounds`: first source row and column, columns of the
    source and of the cells, stride. `strip`: first source row, the one after its last, and its
    first row of cells. Vertices count from the strip's first point. Of several points of one source
    pixel the last is used; the others, and those that the stride skips, are marked `alone`.
    """
    top, left, grid_cols, cols, stride = bounds
    from_row, to_row, first_cells = strip
    _, _, _, between_px = corners
    across = between_px[0]
    down = between_px[1]
    corner, state_at, centres_at, _ = cells
    for g in range(corner.shape[0]):
        corner[g] = NO_POINT
    for g in range(corner.shape[0]):
        state_at[g] = 0
    start = starts[from_row]
    for r in range(from_row, to_row):
        begin = starts[r]
        end = starts[r + 1]
        first = (top + r) * grid_cols + left
        g = ((top + r) // stride - top // stride - first_cells) * cols + 1
        gaps = 0
        for i in range(begin, end - 1):
            gaps += index[i + 1] - index[i] != 1
        if stride == 1 and gaps == 0 and begin < end:  # most rows: vectorised
            # Unsigned indices: numba's check for negative ones prevents vectorisation.
            n = np.uint64(end - begin)
            first_cell = np.uint64(g + index[begin] - first)
            first_point = np.uint64(begin - start)
            for k in range(n):
                corner[first_cell + k] = first_point + k
            for k in range(n):
                state_at[first_cell + k] = state[first_point + k]
            for k in range(n):
                centres_at[first_cell + k] = (np.int64(down[first_point + k]) << 32) ^ np.int64(
                    across[first_point + k]
                )
            continue
        for i in range(begin, end):
            column = index[i] - first
            skipped = stride > 1 and ((top + r) % stride != 0 or (left + column) % stride != 0)
            if skipped or (i + 1 < end and index[i + 1] == index[i]):
                alone[i] = True
                continue
            cell = g + ((left + column) // stride - left // stride if stride > 1 else column)
            k = i - start
            corner[cell] = k
            state_at[cell] = state[k]
            centres_at[cell] = (np.int64(down[k]) << 32) ^ np.int64(across[k])


@inner_kernel()
def classify_quads(cells, todo, late):
    """Classify each quad, and list row by row the quads of the strip that need drawing.

    HAS_TRIANGLE: at least three corners exist. NEEDS_DRAWING: these, all visible, and a pixel
    centre may lie in their bounding box. BEHIND: some corners are not visible. RIM: some but not
    all corners exist, all visible.

    A box holds no centre if all four lie between the same two in x or in y; a stale value of an
    absent corner may enlarge it, which costs time only. Computed with bits, vectorised.

    An entry of `todo` is twice the quad, plus one for its rim, listed after the quads of the row.
    Returns the number of entries and of quads that reach behind the lens.
    """
    _, state, centres, quad = cells
    rows, cols = quad.shape
    n = 0
    n_behind = 0
    for r in range(rows - 1):
        for c in range(cols - 1):
            a = centres[r, c]
            mixed = (
                (a ^ centres[r, c + 1])
                | (a ^ centres[r + 1, c])
                | (a ^ centres[r + 1, c + 1])
                | (~a & PARITY_BITS)
            )
            quad[r, c] = np.uint8(
                NEEDS_DRAWING if ((mixed & LOW_BITS) != 0) & ((mixed & ~LOW_BITS) != 0) else 0
            )
        for c in range(cols - 1):
            i = state[r, c]
            j = state[r, c + 1]
            k = state[r + 1, c]
            m = state[r + 1, c + 1]
            three = ((i & j & (k | m)) | (k & m & (i | j))) & PRESENT
            some = i | j | k | m
            every = i & j & k & m
            unseen = (some & NOT_VISIBLE) >> 1
            seen = np.uint8(unseen ^ 1)
            joined = three | (three * quad[r, c] * seen) | (three * unseen * BEHIND)
            quad[r, c] = np.uint8(joined | ((some & ~every & seen) * RIM))
        if r == 0 or r > rows - 3:
            continue
        m = 0
        for c in range(cols - 1):  # branch-free: whether a quad holds a centre is unpredictable
            todo[n] = 2 * (r * cols + c)
            n += (quad[r, c] & NEEDS_DRAWING) >> 1
            late[m] = 2 * (r * cols + c) + 1
            m += (quad[r, c] & RIM) >> 2
        for c in range(cols - 1):
            n_behind += (quad[r, c] & BEHIND) >> 3
        for c in range(m):
            todo[n + c] = late[c]
        n += m
    return n, n_behind


@inner_kernel()
def mark_isolated_points(cells, start, alone):
    """Mark in `alone` the points, from `start` on, without neighbours to form a triangle, drawn
    or not.
    """
    corner, state, _, quad = cells
    rows, cols = quad.shape
    for r in range(rows - 3):
        above = quad[r]
        below = quad[r + 1]
        present = state[r + 1]
        any_alone = np.uint8(0)
        for c in range(cols - 2):
            any_alone |= (
                (present[c + 1] != 0)
                & ~(above[c] | above[c + 1] | below[c] | below[c + 1])
                & HAS_TRIANGLE
            )
        if any_alone:
            for c in range(cols - 2):
                if (
                    present[c + 1] != 0
                    and (above[c] | above[c + 1] | below[c] | below[c + 1]) & HAS_TRIANGLE == 0
                ):
                    alone[start + corner[r + 1, c + 1]] = True
