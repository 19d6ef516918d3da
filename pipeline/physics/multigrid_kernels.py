# pyright: basic
"""Compiled multigrid solver for -lap v = load, v <= room, v = 0 at the rim.

Truncated cycles detect the contact: the finest level is smoothed against the object, the coarser
ones correct only free nodes (after Graeser and Kornhuber, 2009). Once the contact stays the same,
the rest is a linear problem, which conjugate gradients with such a cycle as preconditioner solve in
a few steps. If the contact keeps changing, monotone cycles (Kornhuber 1994) take over, which are
slower but always converge.

Sealed air makes the load depend on the sum of `v`: the linear problem then contains that dependence
to first order, which is Newton's step, and the next one waits for the contact to settle.

Fields are (rows, cols). `free`: nodes that may move, False at the rim and beyond; `loose`: those of
them that coarse levels correct.
"""

import numpy as np

from pipeline.core.cached_kernels import FAST, inner_kernel, kernel

# of smoothing; the latter are enough for 17 x 14 nodes
_SWEEPS = 2
_COARSEST_SWEEPS = 40
_MAX_CYCLES = 160
_TRUNCATED_CYCLES = 40  # of these; a dozen are usually enough
# with coarse levels up to the contact: fast on smooth objects, overshooting on rough ones
_BOLD_CYCLES = 6
_FEW_NODES = 8  # that still enter or leave the contact when the linear problem is tried
_MAX_STEPS = 30
# of a step of conjugate gradients, to end with it: of the tolerance, below which the error is then
# well, and of the largest step, as the contact may change again
_STEP_SHARE = 0.3
_FIRST_SHARE = 0.1
_LEAST_AIR = 1e-3  # of the air, that a membrane leaves


@kernel(fastmath=FAST)
def solve_obstacle(v, load, room, free, step_sq, n_halvings, tolerance, air):
    """Solve in place from a shape `v`, until a whole cycle changes nothing.

    `air` is (load of its whole pressure, its volume in nodes times height, share of a missing load
    that is safe to add, load that may be missing); all 0 = the load is constant. Returns (load,
    whether it is solved).
    """
    air_load, air_nodes, safe_share, load_tolerance = air
    before = v.copy()
    loose = free & (v < room)
    was_loose = free.copy()
    is_sealed = air_load > 0.0
    follows_air = is_sealed  # in the next linear problem
    for cycle in range(_MAX_CYCLES):
        was_loose[:] = loose
        truncated = cycle < _TRUNCATED_CYCLES
        careful = cycle >= _BOLD_CYCLES
        run_cycle(v, load, room, free, loose, step_sq, n_halvings, truncated, truncated and careful)
        left = max(air_nodes + v.sum(), _LEAST_AIR * air_nodes)
        missing = air_load * (air_nodes / left - 1.0) - load[0, 0] if is_sealed else 0.0
        settled = _find_largest_change(v, before) <= tolerance
        if settled and safe_share * abs(missing) <= load_tolerance:
            return load[0, 0], True
        follows_air |= settled
        few = (loose != was_loose).sum() <= _FEW_NODES
        if truncated and (settled or few):
            if not follows_air:
                missing = 0.0
            stiffness = air_load * air_nodes / left**2 if follows_air else 0.0
            added = _solve_linear(
                v, load, loose, step_sq, n_halvings, careful, tolerance, missing, stiffness
            )
            load += missing - stiffness * added
            v[:] = np.where(free, np.minimum(v, room), v)
            follows_air = False
        elif settled:
            load += safe_share * missing
        before[:] = v
    return load[0, 0], False


@inner_kernel(fastmath=FAST)
def _find_largest_change(v, before):
    most = 0.0
    for r in range(v.shape[0]):
        for c in range(v.shape[1]):
            most = max(most, abs(v[r, c] - before[r, c]))
    return most


@inner_kernel(fastmath=FAST)
def _solve_linear(v, load, loose, step_sq, n_halvings, careful, tolerance, missing, stiffness):
    """Solve the linear problem on the loose nodes by flexible conjugate gradients (Notay 2000):
    a cycle, the preconditioner, is not symmetric.

    The load is `missing` more, less `stiffness` times what is added to `v`, whose sum is returned.
    """
    rows, cols = v.shape
    left = np.empty_like(v)
    guided = np.empty_like(v)
    direction = np.zeros_like(v)
    moved = np.zeros_like(v)
    unbound = np.full_like(v, np.inf)
    nothing = np.zeros_like(v)
    still_loose = loose.copy()
    reduced = 1.0
    added = 0.0
    largest = 0.0
    compute_residual(v, load + missing, unbound, loose, step_sq, left)
    for _ in range(_MAX_STEPS):
        guided[:] = 0.0
        run_cycle(guided, left, unbound, loose, still_loose, step_sq, n_halvings, True, careful)
        known = (guided * moved).sum() / reduced
        swept = 0.0
        for r in range(rows):
            for c in range(cols):
                direction[r, c] = guided[r, c] - known * direction[r, c]
                swept += direction[r, c]
        compute_residual(direction, nothing, unbound, loose, step_sq, moved)
        reduced = 0.0
        curvature = stiffness * swept**2
        for r in range(rows):
            for c in range(cols):
                reduced += direction[r, c] * left[r, c]
                curvature -= direction[r, c] * moved[r, c]
        if not (reduced > 0.0 and curvature > 0.0):
            break
        length = reduced / curvature
        step = 0.0
        for r in range(rows):
            for c in range(cols):
                if loose[r, c]:
                    moved[r, c] = length * (stiffness * swept - moved[r, c])
                    left[r, c] -= moved[r, c]
                    v[r, c] += length * direction[r, c]
                    step = max(step, abs(length * direction[r, c]))
        added += length * swept
        largest = max(largest, step)
        if step <= max(_STEP_SHARE * tolerance, _FIRST_SHARE * largest):
            break
    return added


@inner_kernel(fastmath=FAST)
def run_cycle(v, load, room, free, loose, step_sq, n_halvings, truncated, careful):
    """Run one V-cycle on `v` in place, and write `loose`.

    If `truncated`, coarse levels correct only nodes out of contact, and only away from it if
    `careful`. Otherwise they correct all free nodes and stay below the object: coarse nodes have
    the least clearance nearby.
    """
    # a loop: numba does not load a cached kernel that calls itself
    levels = [(v, load, room, free, loose)]
    for _ in range(n_halvings):
        v, load, room, free, loose = levels[-1]
        _smooth(v, load, room, free, step_sq, _SWEEPS)
        left = np.empty_like(v)
        compute_residual(v, load, room, free, step_sq, left)
        for r in range(v.shape[0]):
            for c in range(v.shape[1]):
                loose[r, c] = free[r, c] and (
                    not truncated or v[r, c] < room[r, c] or left[r, c] != 0.0
                )
        levels.append(_coarsen(left, room, v, loose, not truncated, careful))
        step_sq = 4.0 * step_sq
    v, load, room, free, loose = levels[-1]
    _smooth(v, load, room, free, step_sq, _COARSEST_SWEEPS)
    for level in range(n_halvings - 1, -1, -1):
        step_sq = 0.25 * step_sq
        correction = levels[level + 1][0]
        v, load, room, free, loose = levels[level]
        _prolong(correction, v, room, loose)
        _smooth(v, load, room, free, step_sq, _SWEEPS)


@inner_kernel(fastmath=FAST)
def _smooth(v, load, room, free, step_sq, sweeps):
    """Projected Gauss-Seidel in red-black order."""
    rows, cols = v.shape
    for _ in range(sweeps):
        for colour in range(2):
            for r in range(1, rows - 1):
                for c in range(1 + (r + colour) % 2, cols - 1, 2):
                    if free[r, c]:
                        new = 0.25 * (
                            v[r - 1, c]
                            + v[r + 1, c]
                            + v[r, c - 1]
                            + v[r, c + 1]
                            + step_sq * load[r, c]
                        )
                        v[r, c] = min(new, room[r, c])


@inner_kernel(fastmath=FAST)
def compute_residual(v, load, room, free, step_sq, out):
    """Write load + lap v at free nodes, 0 in contact and at the rim."""
    rows, cols = v.shape
    inverse = 1.0 / step_sq
    out[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                lap = (
                    v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] - 4.0 * v[r, c]
                ) * inverse
                left = load[r, c] + lap
                if not (left > 0.0 and v[r, c] >= room[r, c]):
                    out[r, c] = left


@inner_kernel(fastmath=FAST)
def _coarsen(left, room, v, loose, bounded, careful):
    """Return what `run_cycle` takes first, on every second node: zeros, the residual, the
    clearance, the free nodes.
    """
    rows = left.shape[0] // 2 + 1
    cols = left.shape[1] // 2 + 1
    correction = np.zeros((rows, cols))
    load = np.zeros((rows, cols))
    coarse_room = np.empty((rows, cols))
    free = np.zeros((rows, cols), np.bool_)
    coarse_loose = np.empty((rows, cols), np.bool_)
    for r in range(rows):
        for c in range(cols):
            coarse_room[r, c] = np.inf
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            y = 2 * r
            x = 2 * c
            load[r, c] = (
                0.25 * left[y, x]
                + 0.125 * (left[y - 1, x] + left[y + 1, x] + left[y, x - 1] + left[y, x + 1])
                + 0.0625
                * (
                    left[y - 1, x - 1]
                    + left[y - 1, x + 1]
                    + left[y + 1, x - 1]
                    + left[y + 1, x + 1]
                )
            )
            free[r, c] = loose[y, x] and (
                not careful
                or (loose[y - 1, x] and loose[y + 1, x] and loose[y, x - 1] and loose[y, x + 1])
            )
            if bounded:
                for i in range(y - 1, y + 2):
                    for j in range(x - 1, x + 2):
                        coarse_room[r, c] = min(coarse_room[r, c], max(room[i, j] - v[i, j], 0.0))
    return correction, load, coarse_room, free, coarse_loose


@inner_kernel(fastmath=FAST)
def _prolong(coarse, v, room, free):
    """Add a coarse correction, bilinear between its nodes, without passing the object."""
    rows, cols = v.shape
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                j = r // 2
                i = c // 2
                j2 = j + r % 2
                i2 = i + c % 2
                add = 0.25 * (coarse[j, i] + coarse[j, i2] + coarse[j2, i] + coarse[j2, i2])
                v[r, c] = min(v[r, c] + add, room[r, c])
