"""Multigrid solver for -lap v = load, v <= room, v = 0 at the rim.

Truncated cycles detect the contact: the finest level is smoothed against the object, the coarser ones correct only free
nodes (after Graeser and Kornhuber, 2009). Once the contact stays the same, the rest is a linear problem, which
conjugate gradients with such a cycle as preconditioner solve in a few steps. If the contact keeps changing, monotone
cycles (Kornhuber 1994) take over, which are slower but always converge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Doubles, Mask, freeze

N_HALVINGS = 4  # every lattice side is a multiple of 2^4 steps, so that it can be halved this often
MAX_CYCLES = 160
_TRUNCATED_CYCLES = 40  # of these; a dozen are usually enough
_BOLD_CYCLES = 6  # with coarse levels up to the contact: fast on smooth objects, overshooting on rough ones
_COARSEST_SWEEPS = 40  # enough for 17 x 14 nodes
_FEW_NODES = 2  # that still enter or leave the contact when the linear problem is tried
_MAX_STEPS = 30
_STEP_SHARE = 0.3  # of the tolerance: the error is well below it after a step of this size


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleProblem:
    """Clearance above every node, and which nodes may move.

    Masks are read-only: kernels are compiled again for writable ones.
    """

    clearance_mm: Doubles  # (ny, nx), +inf = open
    free: Mask  # (ny, nx) inside the rim, read-only
    step_mm: float
    n_halvings: int = N_HALVINGS

    def coarsen(self) -> ObstacleProblem:
        """The same problem on every second node."""
        return ObstacleProblem(
            clearance_mm=np.ascontiguousarray(self.clearance_mm[::2, ::2]),
            free=freeze(np.ascontiguousarray(self.free[::2, ::2])),
            step_mm=2 * self.step_mm,
            n_halvings=self.n_halvings - 1,
        )


def solve(grid: ObstacleProblem, start_mm: Doubles, load_per_mm: float, tolerance_mm: float) -> tuple[Doubles, bool]:
    """(v, converged) under a uniform load, from a starting shape; ends when a whole cycle changes nothing."""
    v = np.minimum(start_mm, grid.clearance_mm)
    v[~grid.free] = 0.0
    load = np.full(v.shape, load_per_mm)
    before, loose = v.copy(), grid.free
    for cycle in range(MAX_CYCLES):
        previous_loose, careful = loose, cycle >= _BOLD_CYCLES
        if cycle < _TRUNCATED_CYCLES:
            loose = _run_truncated_cycle(v, load, grid, careful)
        else:
            _run_cycle(v, load, grid.clearance_mm, grid.free, grid.step_mm, grid.n_halvings)
        np.subtract(v, before, out=before)
        if max(float(before.max()), -float(before.min())) <= tolerance_mm:
            return v, True
        if 0 < cycle < _TRUNCATED_CYCLES and np.count_nonzero(loose != previous_loose) <= _FEW_NODES:
            _solve_linear(v, load, grid, loose, careful, tolerance_mm)
            np.minimum(v, grid.clearance_mm, out=v, where=grid.free)
        before[:] = v
    return v, False


def refine(v: Doubles) -> Doubles:
    """A shape on a halved grid, interpolated to the full one (bilinear)."""
    fine = np.empty((2 * v.shape[0] - 1, 2 * v.shape[1] - 1))
    fine[::2, ::2] = v
    fine[1::2, ::2] = 0.5 * (v[:-1] + v[1:])
    fine[:, 1::2] = 0.5 * (fine[:, :-2:2] + fine[:, 2::2])
    return fine


def compute_contact_load(grid: ObstacleProblem, v: Doubles, load_per_mm: float) -> Doubles:
    """Load (ny, nx) of the object on the membrane (1/mm), 0 outside contact."""
    force, inner = np.zeros_like(v), (slice(1, -1), slice(1, -1))
    lap = (v[:-2, 1:-1] + v[2:, 1:-1] + v[1:-1, :-2] + v[1:-1, 2:] - 4.0 * v[inner]) / grid.step_mm**2
    holds = grid.free[inner] & (v[inner] >= grid.clearance_mm[inner])
    force[inner] = np.where(holds, np.maximum(load_per_mm + lap, 0.0), 0.0)
    return force


def _run_truncated_cycle(v: Doubles, load: Doubles, grid: ObstacleProblem, careful: bool) -> Mask:
    """One cycle whose coarse levels keep the contact; returns the nodes outside contact."""
    from pipeline.physics import bubble_kernels as kernels

    step_sq, left = grid.step_mm**2, np.empty_like(v)
    kernels.smooth(v, load, grid.clearance_mm, grid.free, step_sq, 2)
    kernels.compute_residual(v, load, grid.clearance_mm, grid.free, step_sq, left)
    loose = v < grid.clearance_mm
    loose |= left != 0.0
    loose &= grid.free
    freeze(loose)
    correction = _compute_coarse_correction(left, None, loose, grid.step_mm, grid.n_halvings, careful)
    kernels.prolong(correction, v, grid.clearance_mm, loose)
    kernels.smooth(v, load, grid.clearance_mm, grid.free, step_sq, 2)
    return loose


def _solve_linear(
    v: Doubles, load: Doubles, grid: ObstacleProblem, loose: Mask, careful: bool, tolerance_mm: float
) -> None:
    """Solve the linear problem on the loose nodes, in place: flexible conjugate gradients, preconditioned by a cycle.

    The cycle is not symmetric (red before black on the way down and up), hence the flexible form. No array of the
    lattice's size is allocated in a step: allocation costs as much as the sums.
    """
    from pipeline.physics import bubble_kernels as kernels

    left, moved, direction, guided = np.empty_like(v), np.zeros_like(v), np.zeros_like(v), np.empty_like(v)
    unbound, nothing = _get_unbounded(v.shape), np.zeros_like(v)
    kernels.compute_residual(v, load, unbound, loose, grid.step_mm**2, left)
    energy = 1.0
    for _ in range(_MAX_STEPS):
        guided[:] = 0.0
        _run_cycle(guided, left, None, loose, grid.step_mm, grid.n_halvings, careful)
        direction *= _dot(guided, moved) / energy
        direction += guided
        kernels.compute_residual(direction, nothing, unbound, loose, grid.step_mm**2, moved)
        energy, curvature = _dot(direction, left), -_dot(direction, moved)
        if not (energy > 0 and curvature > 0):
            return
        length = energy / curvature
        moved *= length
        left += moved
        v += np.multiply(direction, length, out=guided)
        if max(float(guided.max()), -float(guided.min())) <= _STEP_SHARE * tolerance_mm:
            return


def _dot(a: Doubles, b: Doubles) -> float:
    """Dot product in a fixed order; BLAS distributes it over threads."""
    return float(np.einsum("ij,ij->", a, b))


def _run_cycle(
    v: Doubles, load: Doubles, room: Doubles | None, free: Mask, step_mm: float, level: int, careful: bool = False
) -> None:
    """One cycle, in place, whose corrections stay below the object: coarse nodes take the least clearance nearby."""
    from pipeline.physics import bubble_kernels as kernels

    step_sq, limit = step_mm**2, _get_unbounded(v.shape) if room is None else room
    if level == 0:
        kernels.smooth(v, load, limit, free, step_sq, _COARSEST_SWEEPS)
        return
    kernels.smooth(v, load, limit, free, step_sq, 2)
    left = np.empty_like(v)
    kernels.compute_residual(v, load, limit, free, step_sq, left)
    coarse_room = None if room is None else _restrict_clearance(room - v)
    kernels.prolong(_compute_coarse_correction(left, coarse_room, free, step_mm, level, careful), v, limit, free)
    kernels.smooth(v, load, limit, free, step_sq, 2)


@lru_cache(maxsize=16)
def _get_unbounded(shape: tuple[int, ...]) -> Doubles:
    """Infinite clearance; not written to, yet not read-only, as the kernels would be compiled for that, too."""
    return np.full(shape, np.inf)


def _restrict_clearance(room: Doubles) -> Doubles:
    """The least clearance around every second node, at least 0."""
    coarse = np.full(room[::2, ::2].shape, np.inf)
    around = [room[y : y - 3 or None : 2, x : x - 3 or None : 2] for y in (1, 2, 3) for x in (1, 2, 3)]
    coarse[1:-1, 1:-1] = np.maximum(np.minimum.reduce(around), 0.0)
    return coarse


def _compute_coarse_correction(
    left: Doubles, coarse_room: Doubles | None, free: Mask, step_mm: float, level: int, careful: bool
) -> Doubles:
    """The correction on every second node for a residual; if `careful`, only away from contact."""
    from pipeline.physics import bubble_kernels as kernels

    coarse_free = np.ascontiguousarray(free[::2, ::2])
    if careful:
        y, x = slice(2, -2, 2), slice(2, -2, 2)
        coarse_free[1:-1, 1:-1] &= free[1:-3:2, x] & free[3:-1:2, x] & free[y, 1:-3:2] & free[y, 3:-1:2]
    freeze(coarse_free)
    coarse_load, correction = np.empty(coarse_free.shape), np.zeros(coarse_free.shape)
    kernels.restrict(left, coarse_load)
    _run_cycle(correction, coarse_load, coarse_room, coarse_free, 2 * step_mm, level - 1, careful)
    return correction
