# pyright: basic
"""Compiled loops of the surface mode: triangles are classified in vectorised batches and drawn one
by one.

A batch is one flat array; each row of it holds one quantity of all its triangles: of the corners a,
b and c the position (mm, and px on screen), 1/z and point; the box of pixel centres that the
triangle may cover; the pixel that its barycentric weights are relative to; whether it belongs to a
rim; and the results of `classify_triangles`: its outcome, and 1/z and nearest point on screen at
the first pixel of the box. Row offsets are compile-time constants of a single array, which numba
needs to vectorise the loops.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.cached_kernels import inner_kernel
from pipeline.stages.target_depth.quad_kernels import SLACK

# Outcome of a triangle. From GRAZING on it is drawn, GRAZING as a veil: invisible, but hiding what
# is behind.
JUMP, OVERFULL, BEHIND, GRAZING, FLIPPED, DRAWN = range(6)
PIXELS_SPENT = 6  # counter: pixels that large triangles have visited
N_COUNTS = 7
NOT_COVERING = 6.0  # as a outcome: covers no pixel centre
LARGE_PX = 16  # pixels of the box from which on a triangle counts as large
# Times that large triangles may fill the image: surfaces overlap once or twice, noise close to the
# lens endlessly.
MAX_LAYERS = 8

BATCH_SIZE = 64  # triangles per batch
(
    AX,
    AY,
    AZ,
    AU,
    AV,
    AW,
    A_POINT,
    BX,
    BY,
    BZ,
    BU,
    BV,
    BW,
    B_POINT,
    CX,
    CY,
    CZ,
    CU,
    CV,
    CW,
    C_POINT,
    LEFT,
    RIGHT,
    TOP,
    BOTTOM,
    ORIGIN_X,
    ORIGIN_Y,
    RIM,
    OUTCOME,
    INVERSE_Z,
    POINT,
) = (np.uint64(BATCH_SIZE * row) for row in range(31))
BATCH_LENGTH = 31 * BATCH_SIZE


@inner_kernel()
def classify_triangles(batch, limits):
    """Outcome and first-pixel values of all triangles of a batch; branch-free, for vectorisation.

    The outcome follows from the edge lengths and the angle between normal and line of sight;
    NOT_COVERING if the box is one pixel that the triangle does not cover.
    """
    longest_sq, least_cos = limits
    for lane in range(BATCH_SIZE):
        t = np.uint64(lane)
        x = batch[t + AX]
        y = batch[t + AY]
        z = batch[t + AZ]
        bx = batch[t + BX] - x
        by = batch[t + BY] - y
        bz = batch[t + BZ] - z
        cx = batch[t + CX] - x
        cy = batch[t + CY] - y
        cz = batch[t + CZ] - z
        dx = cx - bx
        dy = cy - by
        dz = cz - bz
        short = (
            (bx * bx + by * by + bz * bz <= longest_sq)
            & (cx * cx + cy * cy + cz * cz <= longest_sq)
            & (dx * dx + dy * dy + dz * dz <= longest_sq)
        )
        nx = by * cz - bz * cy
        ny = bz * cx - bx * cz
        nz = bx * cy - by * cx
        mx = x + (bx + cx) / 3.0
        my = y + (by + cy) / 3.0
        mz = z + (bz + cz) / 3.0
        along = nx * mx + ny * my + nz * mz
        limit_sq = (
            least_cos * least_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
        )
        steep = (along * along >= limit_sq) & (along != 0.0)
        outcome = (FLIPPED + 0.0) + (along > 0.0)
        outcome = outcome if steep else GRAZING + 0.0
        outcome = outcome if short else JUMP + 0.0
        origin_x = batch[t + ORIGIN_X]
        origin_y = batch[t + ORIGIN_Y]
        au = batch[t + AU] - origin_x
        bu = batch[t + BU] - origin_x
        cu = batch[t + CU] - origin_x
        av = batch[t + AV] - origin_y
        bv = batch[t + BV] - origin_y
        cv = batch[t + CV] - origin_y
        area = (bu - au) * (cv - av) - (cu - au) * (bv - av)
        u = batch[t + LEFT] - origin_x
        v = batch[t + TOP] - origin_y
        scale = 1.0 / area
        wa = ((bu - u) * (cv - v) - (cu - u) * (bv - v)) * scale
        wb = ((cu - u) * (av - v) - (au - u) * (cv - v)) * scale
        wc = 1.0 - wa - wb
        off = (batch[t + RIGHT] == batch[t + LEFT]) & (batch[t + BOTTOM] == batch[t + TOP])
        off = off & ((wa < -SLACK) | (wb < -SLACK) | (wc < -SLACK))
        batch[t + OUTCOME] = NOT_COVERING if off | (area == 0.0) else outcome
        batch[t + INVERSE_Z] = wa * batch[t + AW] + wb * batch[t + BW] + wc * batch[t + CW]
        # The corner with the largest weight is nearest on screen.
        a_point = batch[t + A_POINT]
        b_point = batch[t + B_POINT]
        c_point = batch[t + C_POINT]
        largest = wb if wb > wa else wa
        point = b_point if wb > wa else a_point
        batch[t + POINT] = c_point if wc > largest else point


@inner_kernel()
def rasterise_triangle(batch, t, rows, cols, image, counts):
    """Draw one triangle in the covered pixels of its box.

    It is counted if it covers one, or if its box is large.
    """
    inverse_z, veil, source = image
    rim = np.uint64(batch[t + RIM])
    outcome = np.uint64(batch[t + OUTCOME])
    x0 = np.int64(batch[t + ORIGIN_X])
    y0 = np.int64(batch[t + ORIGIN_Y])
    left = np.int64(batch[t + LEFT]) - x0
    right = np.int64(batch[t + RIGHT]) - x0
    top = np.int64(batch[t + TOP]) - y0
    bottom = np.int64(batch[t + BOTTOM]) - y0
    xa = batch[t + AU] - x0
    xb = batch[t + BU] - x0
    xc = batch[t + CU] - x0
    ya = batch[t + AV] - y0
    yb = batch[t + BV] - y0
    yc = batch[t + CV] - y0
    scale = 1.0 / ((xb - xa) * (yc - ya) - (xc - xa) * (yb - ya))
    large = (right - left + 1) * (bottom - top + 1) > LARGE_PX
    counted = False
    if large:
        outcome = (
            np.uint64(OVERFULL) if counts[rim, PIXELS_SPENT] > MAX_LAYERS * rows * cols else outcome
        )
        counts[rim, outcome] += 1
        if outcome < GRAZING:
            return
    for y in range(top, bottom + 1):
        begin = left
        end = right
        if large:
            wa = ((xb - left) * (yc - y) - (xc - left) * (yb - y)) * scale
            wb = ((xc - left) * (ya - y) - (xa - left) * (yc - y)) * scale
            slopes = ((yb - yc) * scale, (yc - ya) * scale, (ya - yb) * scale)
            begin, end = _clip_row((wa, wb, 1.0 - wa - wb), slopes, left, right)
            counts[rim, PIXELS_SPENT] += max(end - begin + 1, 0) + 1
        for x in range(begin, end + 1):
            wa = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) * scale
            wb = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) * scale
            wc = 1.0 - wa - wb
            if wa < -SLACK or wb < -SLACK or wc < -SLACK:
                continue
            if not (large or counted):
                counted = True
                counts[rim, outcome] += 1
            near = wa * batch[t + AW] + wb * batch[t + BW] + wc * batch[t + CW]
            p = np.uint64((y + y0) * cols + x + x0)
            if outcome == GRAZING:
                veil[p] = max(veil[p], near)
            elif outcome > GRAZING and near > inverse_z[p]:
                inverse_z[p] = near
                largest, point = (wb, batch[t + B_POINT]) if wb > wa else (wa, batch[t + A_POINT])
                source[p] = np.int32(batch[t + C_POINT] if wc > largest else point)


@inner_kernel()
def _clip_row(weights, slopes, first, last):
    """Column range of a row in which no weight is negative, one pixel wider on either side.

    `weights` are those at column `first`, `slopes` their change per column.
    """
    low = 0.0
    high = np.float64(last - first)
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
