"""The bubble in contact: an inflated, pre-stretched membrane under an object, with sealed air
behind it.

The membrane's height w over the rim obeys -T lap w = p - lambda with w <= g (the object), lambda >=
0 and lambda (g - w) = 0, the obstacle problem (Kinderlehrer and Stampacchia 1980). Heights are
solved as the deviation from the rest dome, which solves the equation at rest exactly. The air
follows Boyle: (p_atm + p) (V_dead + V(w)) stays what it was untouched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import SettingProblem, ShapeError
from pipeline.physics.lattice import Lattice
from pipeline.sensors.parts import Bubble

STEP_MM = 0.5  # under two pixels of the depth cameras in use; a quarter of the work of 0.25 mm
ATMOSPHERE_KPA = 101.325
TOLERANCE_MM = 1e-4
_PRESSURE_TOLERANCE = 1e-4  # of the gauge pressure: a few micrometres of the free membrane
_MAX_PRESSURES = 25  # tried in the secant search
# mean distance of the nearest clamped nodes beyond a curved rim, in lattice steps
_RIM_STEPS = 0.36
_KPA_TO_N_MM2 = 1e-3
N_HALVINGS = 4  # every lattice side is a multiple of 2^4 steps, so that it can be halved this often


@dataclass(frozen=True, slots=True, kw_only=True)
class BubbleContact:
    """State of the pressed bubble on its lattice."""

    # (ny, nx) from the rest dome: negative toward the camera, positive where it bulges
    deviation_mm: Doubles
    contact_pressure_kpa: Doubles  # (ny, nx) of the object on the membrane
    contact: Mask  # (ny, nx) contact pressure > 0
    pressure_kpa: float  # gauge, inside
    force_n: float
    converged: bool


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


def make_lattice(bubble: Bubble, step_mm: float = STEP_MM) -> Lattice:
    """The lattice centred on the optical axis that holds the whole rim and can be halved for
    multigrid.
    """
    halves = 2**N_HALVINGS
    ny, nx = (
        halves * math.ceil(2 * a / (step_mm * halves)) + 1
        for a in (bubble.half_height_mm, bubble.half_width_mm)
    )
    return Lattice(
        x0_mm=-0.5 * (nx - 1) * step_mm,
        y0_mm=-0.5 * (ny - 1) * step_mm,
        step_mm=step_mm,
        shape=(ny, nx),
    )


def compute_rest_height_mm(bubble: Bubble, on: Lattice) -> Doubles:
    """Height (ny, nx) in mm of the rest dome over the rim plane."""
    return bubble.height_mm * np.maximum(_dome(bubble, on), 0.0)


def find_free_nodes(bubble: Bubble, on: Lattice) -> Mask:
    """Nodes (ny, nx) that may move.

    The first nodes outside are clamped. The rim is drawn in by their mean distance; otherwise the
    membrane is too wide and rises by 0.7 % too much on a half-millimetre lattice, instead of by
    less than 0.1 %.
    """
    width, height = (
        a - _RIM_STEPS * on.step_mm for a in (bubble.half_width_mm, bubble.half_height_mm)
    )
    return freeze((on.x_mm()[None, :] / width) ** 2 + (on.y_mm()[:, None] / height) ** 2 < 1)


def compute_tension_n_per_mm(bubble: Bubble) -> float:
    """The tension T at which the described pressure raises the described dome."""
    curvature = 2.0 * bubble.height_mm * (bubble.half_width_mm**-2 + bubble.half_height_mm**-2)
    if not (curvature > 0 and bubble.pressure_kpa > 0):
        raise SettingProblem("a bubble needs a positive height and pressure")
    return bubble.pressure_kpa * _KPA_TO_N_MM2 / curvature


def press_bubble(
    bubble: Bubble,
    ceiling_mm: NDArray[np.floating],
    on: Lattice,
    *,
    tolerance_mm: float = TOLERANCE_MM,
) -> BubbleContact:
    """The bubble under an object at `ceiling_mm` (ny, nx) over the rim plane.

    Not finite = no object.

    Raises ShapeError for another shape than the lattice's.
    """
    if ceiling_mm.shape != on.shape:
        raise ShapeError(
            f"the ceiling must have the shape {on.shape} of the lattice, got {ceiling_mm.shape}"
        )
    free = find_free_nodes(bubble, on)
    room = np.where(
        np.isfinite(ceiling_mm), ceiling_mm - compute_rest_height_mm(bubble, on), np.inf
    )
    grid = ObstacleProblem(clearance_mm=room, free=free, step_mm=on.step_mm)
    # kPa mm, so that load = pressure / tension is 1 / mm
    tension = compute_tension_n_per_mm(bubble) / _KPA_TO_N_MM2
    v = np.zeros(on.shape)
    over_kpa = 0.0
    settled = True
    if (room < 0).any():
        half = grid.coarsen()  # finds the pressure at a quarter of the cost
        rough = _solve_sealed(
            bubble, half, tension, tolerance_mm, _SealedState(v=np.zeros(half.free.shape))
        )
        answer = _solve_sealed(
            bubble, grid, tension, tolerance_mm, replace(rough, v=refine(rough.v))
        )
        v = answer.v
        over_kpa = answer.over_kpa
        settled = answer.converged
    force = compute_contact_load(grid, v, over_kpa / tension) * tension
    return BubbleContact(
        deviation_mm=freeze(v),
        contact_pressure_kpa=freeze(force),
        contact=freeze(force > 0),
        pressure_kpa=bubble.pressure_kpa + over_kpa,
        force_n=float(force.sum()) * on.step_mm**2 * _KPA_TO_N_MM2,
        converged=settled,
    )


def compute_volume_mm3(bubble: Bubble) -> float:
    """Volume of air between the rim plane and the rest dome."""
    return 0.5 * math.pi * bubble.half_width_mm * bubble.half_height_mm * bubble.height_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class _SealedState:
    """Shape and pressure, and the start of the next search."""

    v: Doubles  # deviation from the dome
    over_kpa: float = 0.0  # rise of the pressure
    slope: float = math.nan  # of the missing pressure over the pressure; NaN = unknown
    converged: bool = True


def _solve_sealed(
    bubble: Bubble,
    grid: ObstacleProblem,
    tension: float,
    tolerance_mm: float,
    start: _SealedState,
) -> _SealedState:
    """Shape and pressure at which Boyle's law holds: secant search over the pressure, with warm
    starts.
    """
    air = bubble.dead_volume_mm3 + compute_volume_mm3(bubble)
    absolute = ATMOSPHERE_KPA + bubble.pressure_kpa
    v = start.v
    settled = True

    def compute_missing_pressure(over_kpa: float) -> float:
        """Pressure in kPa that Boyle's law adds for the volume at this pressure."""
        nonlocal v, settled
        v, settled = solve_obstacle(grid, v, over_kpa / tension, tolerance_mm)
        left = max(air + grid.step_mm**2 * float(v.sum()), 1e-3 * air)
        return absolute * air / left - absolute - over_kpa

    # A pressure dp lifts the free membrane's volume by V dp / p; contact reduces this.
    steepest = -1.0 - absolute / air * compute_volume_mm3(bubble) / bubble.pressure_kpa
    slope = start.slope if math.isfinite(start.slope) else steepest
    over = start.over_kpa
    short = compute_missing_pressure(start.over_kpa)
    for _ in range(_MAX_PRESSURES):
        new = min(max(over - short / slope, 0.0), 8.0 * over + bubble.pressure_kpa)
        if abs(new - over) <= _PRESSURE_TOLERANCE * (bubble.pressure_kpa + over):
            return _SealedState(v=v, over_kpa=over, slope=slope, converged=settled)
        new_short = compute_missing_pressure(new)
        secant = (new_short - short) / (new - over)
        slope = secant if secant < -1.0 else -1.0  # a higher pressure always gives a larger volume
        over = new
        short = new_short
    return _SealedState(v=v, over_kpa=over, slope=slope, converged=False)


@derive_once
def _dome(bubble: Bubble, on: Lattice) -> Doubles:
    return freeze(
        1.0
        - (on.x_mm()[None, :] / bubble.half_width_mm) ** 2
        - (on.y_mm()[:, None] / bubble.half_height_mm) ** 2
    )


def solve_obstacle(
    grid: ObstacleProblem, start_mm: Doubles, load_per_mm: float, tolerance_mm: float
) -> tuple[Doubles, bool]:
    """(v, converged) under a uniform load, from a starting shape."""
    from pipeline.physics import multigrid_kernels as kernels

    room = np.array(grid.clearance_mm, order="C")
    free = np.array(grid.free, order="C")
    v = np.where(free, np.minimum(start_mm, room), 0.0)
    load = np.full_like(v, load_per_mm)
    converged = kernels.solve_obstacle(
        v, load, room, free, grid.step_mm**2, grid.n_halvings, tolerance_mm
    )
    return v, converged


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
