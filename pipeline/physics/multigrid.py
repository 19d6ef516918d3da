"""Multigrid solver for -lap v = load, v <= room, v = 0 at the rim.

Truncated cycles detect the contact: the finest level is smoothed against the object, the coarser
ones correct only free nodes (after Graeser and Kornhuber, 2009). Once the contact stays the same,
the rest is a linear problem, which conjugate gradients with such a cycle as preconditioner solve in
a few steps. If the contact keeps changing, monotone cycles (Kornhuber 1994) take over, which are
slower but always converge.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask

N_HALVINGS = 4  # every lattice side is a multiple of 2^4 steps, so that it can be halved this often
MAX_CYCLES = 160
_TRUNCATED_CYCLES = 40  # of these; a dozen are usually enough
# with coarse levels up to the contact: fast on smooth objects, overshooting on rough ones
_BOLD_CYCLES = 6
_FEW_NODES = 2  # that still enter or leave the contact when the linear problem is tried
_MAX_STEPS = 30
_STEP_SHARE = 0.3  # of the tolerance: the error is well below it after a step of this size

Field = TypeVar("Field", Doubles, Floats)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleProblem:
    """Clearance above every node, and which nodes may move."""

    clearance_mm: Doubles  # (ny, nx), +inf = open
    free: Mask  # (ny, nx) inside the rim
    step_mm: float
    n_halvings: int = N_HALVINGS

    def coarsen(self) -> ObstacleProblem:
        """The same problem on every second node."""
        return ObstacleProblem(
            clearance_mm=self.clearance_mm[::2, ::2],
            free=self.free[::2, ::2],
            step_mm=2 * self.step_mm,
            n_halvings=self.n_halvings - 1,
        )


def solve(
    grid: ObstacleProblem, start_mm: Doubles, load_per_mm: float, tolerance_mm: float
) -> tuple[Doubles, bool]:
    """(v, converged) under a uniform load, from a starting shape.

    Ends when a whole cycle changes nothing.
    """
    from pipeline.physics.multigrid_kernels import run_cycle

    room = np.array(grid.clearance_mm, order="C")
    free = np.array(grid.free, order="C")
    size = (grid.step_mm**2, grid.n_halvings)
    v = np.where(free, np.minimum(start_mm, room), 0.0)
    load = np.full_like(v, load_per_mm)
    before = v.copy()
    loose = free.copy()
    for cycle in range(MAX_CYCLES):
        previous_loose = loose.copy()
        truncated = cycle < _TRUNCATED_CYCLES
        careful = cycle >= _BOLD_CYCLES
        run_cycle(v, load, room, free, loose, *size, truncated, truncated and careful)
        np.subtract(v, before, out=before)
        if max(float(before.max()), -float(before.min())) <= tolerance_mm:
            return v, True
        if (
            0 < cycle < _TRUNCATED_CYCLES
            and np.count_nonzero(loose != previous_loose) <= _FEW_NODES
        ):
            _solve_linear(v, load, loose, size, careful, tolerance_mm)
            np.minimum(v, room, out=v, where=free)
        before[:] = v
    return v, False


def _solve_linear(
    v: Doubles,
    load: Doubles,
    loose: Mask,
    size: tuple[float, int],
    careful: bool,
    tolerance_mm: float,
) -> None:
    """Solve the linear problem on the loose nodes, in place: conjugate gradients, preconditioned by
    a cycle.

    No array of the lattice's size is allocated in a step: allocation costs as much as the sums.
    """
    from pipeline.physics.multigrid_kernels import compute_residual, run_cycle

    left = np.empty_like(v)
    moved = np.empty_like(v)
    guided = np.empty_like(v)
    still_loose = loose.copy()
    unbound = np.full_like(v, np.inf)
    nothing = np.zeros_like(v)

    def apply(direction: Doubles) -> Doubles:
        compute_residual(direction, nothing, unbound, loose, size[0], moved)
        return np.negative(moved, out=moved)

    def run_preconditioner(residual: Doubles) -> Doubles:
        guided[:] = 0.0
        run_cycle(guided, residual, unbound, loose, still_loose, *size, True, careful)
        return guided

    compute_residual(v, load, unbound, loose, size[0], left)
    for step in islice(generate_steps(left, apply, run_preconditioner), _MAX_STEPS):
        v += step
        if max(float(step.max()), -float(step.min())) <= _STEP_SHARE * tolerance_mm:
            return


def generate_steps(
    residual: Field, apply: Callable[[Field], Field], precondition: Callable[[Field], Field]
) -> Generator[Field]:
    """Yield the conjugate gradient steps whose sum solves A x = b.

    The caller adds them up and stops.

    The flexible form (Notay 2000): a direction is made orthogonal to the last by A itself, so that
    the preconditioner may be unsymmetric or inexact, such as one cycle of multigrid.

    `residual` is b at first, and b - A x in place after each step. `apply` is x -> A x, symmetric
    and positive on the directions that `precondition` gives. Both may return buffers of their own:
    a step is valid until the next one, and no array is allocated in it. Ends where no step reduces
    the residual any more.
    """
    direction = np.zeros_like(residual)
    moved = np.zeros_like(residual)
    reduced = 1.0
    while True:
        guided = precondition(residual)
        direction *= -compute_dot(guided, moved) / reduced
        direction += guided
        moved = apply(direction)
        reduced = compute_dot(direction, residual)
        curvature = compute_dot(direction, moved)
        if not (reduced > 0.0 and curvature > 0.0):
            return
        moved *= reduced / curvature
        residual -= moved
        np.multiply(direction, reduced / curvature, out=guided)
        yield guided


def compute_dot(a: Doubles | Floats, b: Doubles | Floats) -> float:
    """The dot product of two fields in double precision and in a fixed order.

    BLAS distributes it over threads.
    """
    return float(np.einsum("i,i->", a.ravel(), b.ravel(), dtype=np.float64))


def refine(v: Doubles) -> Doubles:
    """A shape on a halved grid, interpolated to the full one (bilinear)."""
    fine = np.empty((2 * v.shape[0] - 1, 2 * v.shape[1] - 1))
    fine[::2, ::2] = v
    fine[1::2, ::2] = 0.5 * (v[:-1] + v[1:])
    fine[:, 1::2] = 0.5 * (fine[:, :-2:2] + fine[:, 2::2])
    return fine


def compute_contact_load(grid: ObstacleProblem, v: Doubles, load_per_mm: float) -> Doubles:
    """Load (ny, nx) of the object on the membrane (1/mm), 0 outside contact."""
    force = np.zeros_like(v)
    inner = (slice(1, -1), slice(1, -1))
    lap = (
        v[:-2, 1:-1] + v[2:, 1:-1] + v[1:-1, :-2] + v[1:-1, 2:] - 4.0 * v[inner]
    ) / grid.step_mm**2
    holds = grid.free[inner] & (v[inner] >= grid.clearance_mm[inner])
    force[inner] = np.where(holds, np.maximum(load_per_mm + lap, 0.0), 0.0)
    return force
