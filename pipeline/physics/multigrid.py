"""Multigrid for -lap v = load, v <= room, v = 0 at the rim.

Truncated cycles find where the object holds the membrane: the finest level is smoothed against the object, the coarser
ones correct only what is free (after Graeser and Kornhuber, 2009). Once the held nodes stay the same, the rest is a
linear problem, which conjugate gradients with such a cycle as preconditioner end in a handful of steps. Should the held
nodes not come to rest, monotone cycles (Kornhuber 1994), slower but sure, take over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Mask, freeze

HALVINGS = 4  # every lattice side is a multiple of 2^4 steps, so that it can be halved this often
MAX_CYCLES = 160
_TRUNCATED_CYCLES = 40  # of these; usually a dozen are enough
_BOLD_CYCLES = (
    6  # whose coarse levels cover all that is free nearby: quick on smooth objects, overshooting on rough ones
)
_COARSEST_SWEEPS = 40  # enough for 17 x 14 nodes
_FEW_NODES = 2  # that still change hands when the linear problem is tried
_MAX_STEPS = 30
_STEP_SHARE = 0.3  # a step of this share of the tolerance leaves an error well within it


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """One obstacle problem: how much room there is above every node, and which nodes may move at all.

    Masks of nodes are read-only wherever kernels take them, which are compiled anew for those that are not.
    """

    room_mm: Doubles  # (ny, nx), +inf = open
    free: Mask  # (ny, nx) inside the rim, read-only
    step_mm: float
    halvings: int = HALVINGS

    def halved(self) -> Grid:
        """The same problem on every second node."""
        return Grid(
            room_mm=np.ascontiguousarray(self.room_mm[::2, ::2]),
            free=freeze(np.ascontiguousarray(self.free[::2, ::2])),
            step_mm=2 * self.step_mm,
            halvings=self.halvings - 1,
        )


def solve(grid: Grid, start_mm: Doubles, load_per_mm: float, tolerance_mm: float) -> tuple[Doubles, bool]:
    """(v, converged) under a uniform load, from a starting shape; ends when a whole cycle moves nothing any more."""
    from pipeline.physics import bubble_kernels as kernels

    v = np.minimum(start_mm, grid.room_mm)
    v[~grid.free] = 0.0
    load = np.full(v.shape, load_per_mm)
    before, loose = v.copy(), grid.free
    for cycle in range(MAX_CYCLES):
        was_loose, careful = loose, cycle >= _BOLD_CYCLES
        if cycle < _TRUNCATED_CYCLES:
            loose = _truncated_cycle(v, load, grid, careful)
        else:
            _monotone_cycle(v, load, grid.room_mm, grid.free, grid.step_mm, grid.halvings)
        if kernels.largest_change(v, before) <= tolerance_mm:
            return v, True
        if 0 < cycle < _TRUNCATED_CYCLES and np.count_nonzero(loose != was_loose) <= _FEW_NODES:
            _settle(v, load, grid, loose, careful, tolerance_mm)
            np.minimum(v, grid.room_mm, out=v, where=grid.free)
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


def _truncated_cycle(v: Doubles, load: Doubles, grid: Grid, careful: bool) -> Mask:
    """One cycle whose coarse levels leave the held nodes where they are; the nodes that were not held."""
    from pipeline.physics import bubble_kernels as kernels

    step_sq = grid.step_mm**2
    kernels.smooth(v, load, grid.room_mm, grid.free, step_sq, 2)
    left, loose = np.empty_like(v), np.empty_like(grid.free)
    kernels.residual(v, load, grid.room_mm, grid.free, step_sq, left)
    kernels.not_held(v, left, grid.room_mm, grid.free, loose)
    freeze(loose)
    kernels.prolong(_coarse_correction(left, loose, grid.step_mm, grid.halvings, careful), v, grid.room_mm, loose)
    kernels.smooth(v, load, grid.room_mm, grid.free, step_sq, 2)
    return loose


def _coarse_correction(left: Doubles, free: Mask, step_mm: float, level: int, careful: bool) -> Doubles:
    """The correction on every second node for a residual; obstacles are no longer seen."""
    from pipeline.physics import bubble_kernels as kernels

    coarse_free = np.empty_like(free[::2, ::2], order="C")
    kernels.halve_free(free, careful, coarse_free)
    freeze(coarse_free)
    coarse_load, correction = np.empty(coarse_free.shape), np.zeros(coarse_free.shape)
    kernels.restrict_open(left, coarse_load)
    _linear_cycle(correction, coarse_load, coarse_free, 2 * step_mm, level - 1, careful)
    return correction


def _linear_cycle(v: Doubles, load: Doubles, free: Mask, step_mm: float, level: int, careful: bool) -> None:
    from pipeline.physics import bubble_kernels as kernels

    step_sq = step_mm**2
    if level == 0:
        kernels.smooth_open(v, load, free, step_sq, _COARSEST_SWEEPS)
        return
    kernels.smooth_open(v, load, free, step_sq, 2)
    left = np.empty_like(v)
    kernels.residual_open(v, load, free, step_sq, left)
    kernels.prolong_open(_coarse_correction(left, free, step_mm, level, careful), v, free)
    kernels.smooth_open(v, load, free, step_sq, 2)


def _settle(v: Doubles, load: Doubles, grid: Grid, loose: Mask, careful: bool, tolerance_mm: float) -> None:
    """Solve the linear problem on the loose nodes, in place: flexible conjugate gradients, a cycle to guide each step.

    The guide is not symmetric (red before black on the way down and up), hence the flexible form.
    """
    from pipeline.physics import bubble_kernels as kernels

    left, moved, direction = np.empty_like(v), np.zeros_like(v), np.zeros_like(v)
    kernels.residual_open(v, load, loose, grid.step_mm**2, left)
    energy, length = 1.0, 0.0
    for _ in range(_MAX_STEPS):
        guided = np.zeros_like(v)
        _linear_cycle(guided, left, loose, grid.step_mm, grid.halvings, careful)
        kernels.add_scaled(guided, -length * kernels.dot(guided, moved) / energy, direction)  # direction is replaced
        energy = kernels.dot(direction, left)
        curvature = kernels.stiffness(direction, loose, grid.step_mm**2, moved)
        if not (energy > 0 and curvature > 0):
            return
        length = energy / curvature
        if kernels.walk(v, left, direction, moved, length) <= _STEP_SHARE * tolerance_mm:
            return


def _monotone_cycle(v: Doubles, load: Doubles, room: Doubles, free: Mask, step_mm: float, level: int) -> None:
    """One cycle whose corrections never pass the object: coarse nodes have the least room of those around them."""
    from pipeline.physics import bubble_kernels as kernels

    step_sq = step_mm**2
    if level == 0:
        kernels.smooth(v, load, room, free, step_sq, _COARSEST_SWEEPS)
        return
    kernels.smooth(v, load, room, free, step_sq, 2)
    left = np.empty_like(v)
    kernels.residual(v, load, room, free, step_sq, left)
    coarse_free = freeze(np.ascontiguousarray(free[::2, ::2]))
    coarse_load, coarse_room = np.empty(coarse_free.shape), np.empty(coarse_free.shape)
    kernels.restrict(left, v, room, coarse_load, coarse_room)
    correction = np.zeros(coarse_free.shape)
    _monotone_cycle(correction, coarse_load, coarse_room, coarse_free, 2 * step_mm, level - 1)
    kernels.prolong(correction, v, room, free)
    kernels.smooth(v, load, room, free, step_sq, 2)
