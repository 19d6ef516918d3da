# pyright: basic
"""Compiled loops of the surface mode: triangles judged many at once, on vectors, and drawn one after the other.

They lie on a desk, a flat array of which row by row holds one figure of all its triangles: of the corners a, b and c
where they are (mm, and px on screen), their 1/z and the point that each stands for; the box of pixel centres that the
triangle may cover; the pixel that its weights are reckoned from; whether it belongs to a rim; and what `judge` finds:
its fate, and, for the first pixel of the box, the 1/z there and the point that is nearest on screen. Rows begin at
numbers that are known when this is compiled, and all of them in one array: only so are the loops put on vectors.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.cached_kernels import inner_kernel
from pipeline.stages.target_depth.quad_kernels import SLACK

# What becomes of a triangle. From GRAZING on it is drawn: that one as a veil, which is not seen and hides.
JUMP, OVERFULL, BEHIND, GRAZING, FLIPPED, DRAWN = range(6)
PIXELS_SPENT = 6  # how many pixels large triangles have taken so far
N_COUNTS = 7
NOT_COVERING = 6.0  # as a fate: covers no pixel centre
LARGE_PX = 16  # pixels of a triangle's box from which on it is asked first whether it is worth drawing
MAX_LAYERS = (
    8  # times that large triangles may fill the image: surfaces fold over once or twice, noise at the lens endlessly
)

BATCH_SIZE = 64  # triangles on a desk
(
    AX, AY, AZ, AU, AV, AW, A_POINT, BX, BY, BZ, BU, BV, BW, B_POINT, CX, CY, CZ, CU, CV, CW, C_POINT,
    LEFT, RIGHT, TOP, BOTTOM, ORIGIN_X, ORIGIN_Y, RIM, OUTCOME, INVERSE_Z, POINT,
) = (np.uint64(BATCH_SIZE * row) for row in range(31))  # fmt: skip
BATCH_LENGTH = 31 * BATCH_SIZE


@inner_kernel()
def classify_triangles(batch, limits):
    """Find the fate, and what the first pixel sees, of all triangles; no branches, so that it runs on vectors.

    The fate is by the edges and by the angle between normal and line of sight; MISSED, if the box is one pixel that the
    triangle does not cover.
    """
    longest_sq, least_cos = limits
    for turn in range(BATCH_SIZE):
        t = np.uint64(turn)
        x, y, z = batch[t + AX], batch[t + AY], batch[t + AZ]
        bx, by, bz = batch[t + BX] - x, batch[t + BY] - y, batch[t + BZ] - z
        cx, cy, cz = batch[t + CX] - x, batch[t + CY] - y, batch[t + CZ] - z
        dx, dy, dz = cx - bx, cy - by, cz - bz
        short = (
            (bx * bx + by * by + bz * bz <= longest_sq)
            & (cx * cx + cy * cy + cz * cz <= longest_sq)
            & (dx * dx + dy * dy + dz * dz <= longest_sq)
        )
        nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        mx, my, mz = x + (bx + cx) / 3.0, y + (by + cy) / 3.0, z + (bz + cz) / 3.0
        along = nx * mx + ny * my + nz * mz
        limit_sq = least_cos * least_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
        steep = (along * along >= limit_sq) & (along != 0.0)
        fate = (FLIPPED + 0.0) + (along > 0.0)
        fate = fate if steep else GRAZING + 0.0
        fate = fate if short else JUMP + 0.0
        from_x, from_y = batch[t + ORIGIN_X], batch[t + ORIGIN_Y]
        au, bu, cu = batch[t + AU] - from_x, batch[t + BU] - from_x, batch[t + CU] - from_x
        av, bv, cv = batch[t + AV] - from_y, batch[t + BV] - from_y, batch[t + CV] - from_y
        area = (bu - au) * (cv - av) - (cu - au) * (bv - av)
        u, v, scale = batch[t + LEFT] - from_x, batch[t + TOP] - from_y, 1.0 / area
        wa = ((bu - u) * (cv - v) - (cu - u) * (bv - v)) * scale
        wb = ((cu - u) * (av - v) - (au - u) * (cv - v)) * scale
        wc = 1.0 - wa - wb
        off = (batch[t + RIGHT] == batch[t + LEFT]) & (batch[t + BOTTOM] == batch[t + TOP])
        off = off & ((wa < -SLACK) | (wb < -SLACK) | (wc < -SLACK))
        batch[t + OUTCOME] = NOT_COVERING if off | (area == 0.0) else fate
        batch[t + INVERSE_Z] = wa * batch[t + AW] + wb * batch[t + BW] + wc * batch[t + CW]
        # The corner with the largest weight is the nearest one on screen.
        a_point, b_point, c_point = batch[t + A_POINT], batch[t + B_POINT], batch[t + C_POINT]
        largest, point = (wb if wb > wa else wa), (b_point if wb > wa else a_point)
        batch[t + POINT] = c_point if wc > largest else point


@inner_kernel()
def rasterise_triangle(batch, t, rows, cols, image, counts):
    """Draw one triangle in the pixels of its box that it covers; it counts if there is one, or if the box is large."""
    inverse_z, veil, source = image
    rim, fate = np.uint64(batch[t + RIM]), np.uint64(batch[t + OUTCOME])
    x0, y0 = np.int64(batch[t + ORIGIN_X]), np.int64(batch[t + ORIGIN_Y])
    left, right = np.int64(batch[t + LEFT]) - x0, np.int64(batch[t + RIGHT]) - x0
    top, bottom = np.int64(batch[t + TOP]) - y0, np.int64(batch[t + BOTTOM]) - y0
    xa, xb, xc = batch[t + AU] - x0, batch[t + BU] - x0, batch[t + CU] - x0
    ya, yb, yc = batch[t + AV] - y0, batch[t + BV] - y0, batch[t + CV] - y0
    scale = 1.0 / ((xb - xa) * (yc - ya) - (xc - xa) * (yb - ya))
    large, counted = (right - left + 1) * (bottom - top + 1) > LARGE_PX, False
    if large:
        fate = np.uint64(OVERFULL) if counts[rim, PIXELS_SPENT] > MAX_LAYERS * rows * cols else fate
        counts[rim, fate] += 1
        if fate < GRAZING:
            return
    for y in range(top, bottom + 1):
        begin, end = left, right
        if large:
            wa = ((xb - left) * (yc - y) - (xc - left) * (yb - y)) * scale
            wb = ((xc - left) * (ya - y) - (xa - left) * (yc - y)) * scale
            slopes = ((yb - yc) * scale, (yc - ya) * scale, (ya - yb) * scale)
            begin, end = _columns((wa, wb, 1.0 - wa - wb), slopes, left, right)
            counts[rim, PIXELS_SPENT] += max(end - begin + 1, 0) + 1
        for x in range(begin, end + 1):
            wa = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) * scale
            wb = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) * scale
            wc = 1.0 - wa - wb
            if wa < -SLACK or wb < -SLACK or wc < -SLACK:
                continue
            if not (large or counted):
                counted = True
                counts[rim, fate] += 1
            near, p = wa * batch[t + AW] + wb * batch[t + BW] + wc * batch[t + CW], np.uint64((y + y0) * cols + x + x0)
            if fate == GRAZING:
                veil[p] = max(veil[p], near)
            elif fate > GRAZING and near > inverse_z[p]:
                inverse_z[p] = near
                largest, point = (wb, batch[t + B_POINT]) if wb > wa else (wa, batch[t + A_POINT])
                source[p] = np.int32(batch[t + C_POINT] if wc > largest else point)


@inner_kernel()
def _columns(weights, slopes, first, last):
    """The columns of a row in which no weight is negative, to a pixel more on either side.

    `weights` are those at column `first`, `slopes` what they gain per column.
    """
    low, high = 0.0, np.float64(last - first)
    for k in range(3):
        if slopes[k] != 0.0:
            zero = -weights[k] / slopes[k]
            if slopes[k] > 0.0 and zero - 1.0 > low:
                low = zero - 1.0
            elif slopes[k] < 0.0 and zero + 1.0 < high:
                high = zero + 1.0
    if not low <= high:
        return first, first - 1
    return first + np.int64(low), first + np.int64(np.ceil(high))
