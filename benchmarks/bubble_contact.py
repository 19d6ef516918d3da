"""How fast is a bubble's contact at equal accuracy? Projected multigrid beside an active set with a sparse solver.

    python benchmarks/bubble_contact.py

A ball of 20 mm radius reaches 6 mm into the soft bubble, the pressure inside held. The peer is the primal-dual active
set method (Hintermueller, Ito and Kunisch 2003): solve the free nodes with scipy's sparse solver, move the boundary of
the contact, until nothing changes. It is exact on the grid, so its answer is the truth that our error is measured from.
Same grid, same inputs, in turn; medians.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from pathlib import Path

import numba
import numpy as np
import scipy
from scipy import sparse
from scipy.sparse import linalg

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.physics import bubble, multigrid
from pipeline.physics.lattice import Lattice
from pipeline.sensors.spec import sensor

_BUBBLE = sensor("soft_bubble").bubble
_RADIUS_MM, _REACH_MM, _OVER_KPA = 20.0, 6.0, 0.05
_TOLERANCES_MM = (1e-4, 1e-6, 1e-8)
_EQUAL_MM = 1e-6  # a nanometre: the active set is exact to rounding; both are then the same surface to any instrument


def main() -> None:
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; numpy {np.__version__}, "
          f"scipy {scipy.__version__}, numba {numba.__version__}")  # fmt: skip
    print(f"{'question':<22}{'peer':<24}{'ours ms':>9}{'peer ms':>10}{'ratio':>8}{'our max mm':>12}  bar")
    for step_mm, runs in ((0.75, 9), (0.5, 5), (0.375, 3)):
        _race(step_mm, runs)


def _race(step_mm: float, runs: int) -> None:
    on = bubble.lattice(_BUBBLE, step_mm)
    grid, load = problem(on)
    truth, solves = active_set(grid, load)
    answers = {t: lambda t=t: multigrid.solve(grid, np.zeros(on.shape), load, t)[0] for t in _TOLERANCES_MM}
    errors = {t: float(np.abs(run() - truth).max()) for t, run in answers.items()}  # outputs are compared first
    ours: dict[float, list[float]] = {t: [] for t in answers}
    peer: list[float] = []
    for _ in range(runs):
        peer.append(_ms(lambda: active_set(grid, load)))
        for t, run in answers.items():
            ours[t].extend(_ms(run) for _ in range(3))
    theirs = float(np.median(peer))
    for t in answers:
        mine = float(np.median(ours[t]))
        equal = errors[t] <= _EQUAL_MM
        bar = (
            f"80x at equal accuracy: {'holds' if theirs / mine >= 80 else 'MISSED'}" if equal else "not equal accuracy"
        )
        print(f"{on.shape[0]:>3} x {on.shape[1]:<3} to {t:.0e} mm  {f'active set, {solves} solves':<24}{mine:>7.2f}"
              f"{theirs:>10.0f}{theirs / mine:>8.0f}{errors[t]:>12.1e}  {bar}")  # fmt: skip


def problem(on: Lattice) -> tuple[multigrid.Grid, float]:
    """(the room around the rest dome and the free nodes, load per mm) of the ball."""
    x, y = on.x_mm()[None, :], on.y_mm()[:, None]
    low = _RADIUS_MM**2 - (x - 8.0) ** 2 - (y + 5.0) ** 2
    rest = bubble.rest_height_mm(_BUBBLE, on)
    ceiling = _BUBBLE.height_mm - _REACH_MM + _RADIUS_MM - np.sqrt(np.maximum(low, 0.0))
    free = bubble.free_nodes(_BUBBLE, on)
    room = np.where(low > 0, ceiling - rest, np.inf)
    return multigrid.Grid(room_mm=room, free=free, step_mm=on.step_mm), _OVER_KPA * 1e-3 / bubble.tension_n_per_mm(
        _BUBBLE
    )


def active_set(grid: multigrid.Grid, load: float):
    """(v, number of sparse solves) on the free nodes."""
    index = np.full(grid.free.shape, -1)
    index[grid.free] = np.arange(grid.free.sum())
    n = int(grid.free.sum())
    pairs = [
        (a[m], b[m]) for a, b in ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:])) for m in [(a >= 0) & (b >= 0)]
    ]
    i, j = (np.concatenate([p[k] for p in pairs]) for k in (0, 1))
    near = sparse.coo_matrix((np.ones(len(i)), (i, j)), (n, n))
    a = ((4 * sparse.eye(n) - near - near.T) / grid.step_mm**2).tocsc()
    room, b = grid.room_mm[grid.free], np.full(n, load)
    v, held = np.minimum(0.0, room), room < 0
    solves = 0
    while solves < 200:
        solves += 1
        open_ = np.flatnonzero(~held)
        v = np.where(held, room, 0.0)
        v[open_] = linalg.spsolve(a[open_][:, open_], (b - a @ v)[open_], use_umfpack=False)
        force = np.where(held, b - a @ v, 0.0)
        now = np.where(held, force > 0, v > room)
        if (now == held).all():
            break
        held = now
    whole = np.zeros(grid.free.shape)
    whole[grid.free] = v
    return whole, solves


def _ms(run) -> float:
    started = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - started)


if __name__ == "__main__":
    main()
