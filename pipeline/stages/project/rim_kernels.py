# pyright: basic
"""Compiled loops of the surface mode: the rim of a touch, half a source pixel beyond its outermost points.

A source pixel stands for its square, so the true border of a mask lies between the last pixel inside and the first
outside. Quads that have some of their corners are drawn up to the middle of their edges, which depth reaches on the
straight line through a border point and the one behind it; never through two points farther apart than an edge may be.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.stages.project.triangle_kernels import BORROWED, N_COUNTS, THERE, between, draw


@njit(cache=True)
def rim_room():
    """What `draw_rim` works in: a quad's corners and what lies behind them; four corners, and two beyond each."""
    corner, ahead, behind = np.zeros(4, dtype=np.int64), np.zeros(4, dtype=np.int64), np.zeros(4, dtype=np.int64)
    name, across, down = np.zeros(12, dtype=np.int32), np.zeros(12, dtype=np.int32), np.zeros(12, dtype=np.int32)
    itself, points = np.arange(12).astype(np.int32), np.zeros(36, dtype=np.float64)
    pu, pv, pw, counts = np.zeros(12), np.zeros(12), np.zeros(12), np.zeros(N_COUNTS, dtype=np.int64)
    return corner, ahead, behind, name, across, down, itself, points, pu, pv, pw, counts


@njit(**BORROWED)
def draw_rim(flat, at, u, v, w, state, columns, rows, lens, z_min, limits, shape, inverse_z, source, room):
    """Draw what quads with some of their corners are worth; three corners have had their triangle already.

    `rows` are where the corners of four source rows begin: the quads' upper and lower row are the middle two.
    Pixels get the border point that their piece of the rim begins at as `source`.
    """
    before, upper, lower, after = rows
    corner, ahead, behind, name, across, down, itself, points, pu, pv, pw, counts = room
    for turn in range(columns.shape[0]):
        c = columns[turn]
        # In turn around the quad. What lies beyond a corner, seen from the next corner and from the one before.
        corner[0], corner[1], corner[2], corner[3] = upper + c, upper + c + 1, lower + c + 1, lower + c
        ahead[0], ahead[1], ahead[2], ahead[3] = upper + c - 1, before + c + 1, lower + c + 2, after + c
        behind[0], behind[1], behind[2], behind[3] = before + c, upper + c + 2, after + c + 1, lower + c - 1
        for k in range(4):
            if state[corner[k]] == THERE:
                _take(flat, at, u, v, w, corner[k], points, name, pu, pv, pw, k)
                if state[corner[(k + 1) & 3]] != THERE:
                    _reach(flat, at, state, ahead[k], lens, z_min, limits[0], points, name, pu, pv, pw, k, 4 + k)
                if state[corner[(k + 3) & 3]] != THERE:
                    _reach(
                        flat,
                        at,
                        state,
                        behind[k],
                        lens,
                        z_min,
                        limits[0],
                        points,
                        name,
                        pu,
                        pv,
                        pw,
                        k,
                        8 + k,
                    )
        between(pu, across, shape[1])
        between(pv, down, shape[0])
        for k in range(4):
            if state[corner[k]] != THERE or state[corner[(k + 3) & 3]] == THERE:
                continue
            last = k  # of the corners in a run that begins with k
            while state[corner[(last + 1) & 3]] == THERE:
                last = (last + 1) & 3
            if last != k:
                draw(
                    points,
                    itself,
                    name,
                    pu,
                    pv,
                    pw,
                    across,
                    down,
                    k,
                    last,
                    4 + last,
                    limits,
                    shape,
                    inverse_z,
                    source,
                    counts,
                )
            draw(
                points,
                itself,
                name,
                pu,
                pv,
                pw,
                across,
                down,
                k,
                4 + last,
                8 + k,
                limits,
                shape,
                inverse_z,
                source,
                counts,
            )


@njit(**BORROWED)
def _take(flat, at, u, v, w, i, points, name, pu, pv, pw, to):
    for axis in range(3):
        points[3 * to + axis] = flat[3 * at[i] + axis]
    name[to], pu[to], pv[to], pw[to] = at[i], u[i], v[i], w[i]


@njit(**BORROWED)
def _reach(flat, at, state, inner, lens, z_min, max_edge_sq, points, name, pu, pv, pw, k, to):
    """Put at `to` what lies half a step beyond corner `k`, coming from the `inner` one; the corner itself, if none."""
    name[to], pu[to], pv[to], pw[to] = name[k], pu[k], pv[k], pw[k]
    for axis in range(3):
        points[3 * to + axis] = points[3 * k + axis]
    if state[inner] != THERE:
        return
    x, y, z = points[3 * k], points[3 * k + 1], points[3 * k + 2]
    p = 3 * at[inner]
    dx, dy, dz = x - flat[p], y - flat[p + 1], z - flat[p + 2]
    x, y, z = x + 0.5 * dx, y + 0.5 * dy, z + 0.5 * dz
    if not (dx * dx + dy * dy + dz * dz <= max_edge_sq and z > z_min):
        return
    points[3 * to], points[3 * to + 1], points[3 * to + 2] = x, y, z
    pw[to] = 1.0 / z
    pu[to], pv[to] = lens[0] * x * pw[to] + lens[2], lens[1] * y * pw[to] + lens[3]
