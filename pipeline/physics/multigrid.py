"""Projected multigrid for -lap v = load, v <= room, v = 0 at the rim: monotone coarse obstacles (methods 1.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Doubles, Mask

HALVINGS = 4  # every lattice side is a multiple of 2^4 steps, so that it can be halved this often
MAX_CYCLES = 120
_COARSEST_SWEEPS = 60  # enough for 17 x 14 nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """One obstacle problem: how much room there is above every node, and which nodes may move at all."""

    room_mm: Doubles  # (ny, nx), +inf = open
    free: Mask  # (ny, nx) inside the rim
    step_mm: float
    halvings: int = HALVINGS

    def halved(self) -> Grid:
        """The same problem on every second node."""
        return Grid(
            room_mm=np.ascontiguousarray(self.room_mm[::2, ::2]),
            free=np.ascontiguousarray(self.free[::2, ::2]),
            step_mm=2 * self.step_mm,
            halvings=self.halvings - 1,
        )


def solve(grid: Grid, start_mm: Doubles, load_per_mm: float, tolerance_mm: float) -> tuple[Doubles, bool]:
    """(v, converged) under a uniform load, from a starting shape; V(2,2) cycles until one moves nothing any more."""
    v = np.minimum(start_mm, grid.room_mm)
    v[~grid.free] = 0.0
    load = np.full(v.shape, load_per_mm)
    before = v.copy()
    for _ in range(MAX_CYCLES):
        _cycle(v, load, grid.room_mm, grid.free, grid.step_mm, grid.halvings)
        if float(np.abs(v - before).max()) <= tolerance_mm:
            return v, True
        before[:] = v
    return v, False


def finer(v: Doubles) -> Doubles:
    """A shape on a halved grid, carried to the full one (bilinear)."""
    fine = np.empty((2 * v.shape[0] - 1, 2 * v.shape[1] - 1))
    fine[::2, ::2] = v
    fine[1::2, ::2] = 0.5 * (v[:-1] + v[1:])
    fine[:, 1::2] = 0.5 * (fine[:, :-2:2] + fine[:, 2::2])
    return fine


def held(grid: Grid, v: Doubles, load_per_mm: float) -> Doubles:
    """What the object adds to the load where it holds the membrane (1/mm), 0 elsewhere."""
    from pipeline.physics import bubble_kernels

    force = np.zeros_like(v)
    bubble_kernels.held(v, np.full(v.shape, load_per_mm), grid.room_mm, grid.free, grid.step_mm**2, force)
    return force


def _cycle(v: Doubles, load: Doubles, room: Doubles, free: Mask, step_mm: float, level: int) -> None:
    from pipeline.physics import bubble_kernels as kernels

    step_sq = step_mm**2
    if level == 0:
        kernels.smooth(v, load, room, free, step_sq, _COARSEST_SWEEPS)
        return
    kernels.smooth(v, load, room, free, step_sq, 2)
    left = np.empty_like(v)
    kernels.residual(v, load, room, free, step_sq, left)
    coarse_free = np.ascontiguousarray(free[::2, ::2])
    coarse_load, coarse_room = np.empty(coarse_free.shape), np.empty(coarse_free.shape)
    kernels.restrict(left, v, room, coarse_load, coarse_room)
    correction = np.zeros(coarse_free.shape)
    _cycle(correction, coarse_load, coarse_room, coarse_free, 2 * step_mm, level - 1)
    kernels.prolong(correction, v, room, free)
    kernels.smooth(v, load, room, free, step_sq, 2)
