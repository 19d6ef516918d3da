"""The bubble in contact: an inflated, pre-stretched membrane under an object, with sealed air
behind it.

The membrane's height w over the rim obeys -T lap w = p - lambda with w <= g (the object), lambda >=
0 and lambda (g - w) = 0, the obstacle problem (Kinderlehrer and Stampacchia 1980). Heights are
solved as the deviation from the rest dome, which solves the equation at rest exactly. The air
follows Boyle: (p_atm + p) (V_dead + V(w)) stays what it was untouched.

Depth camera of a bubble: conversions between its lattice and depth images, and simulated frames.

A frame is the exact depth along each ray with the errors of depth cameras: noise that grows with
distance and grazing incidence, flying pixels where the depth jumps, gaps (NaN) where a surface is
too steep, and a coarse step.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, Reals, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.normals import compute_area_vectors
from pipeline.core.values.results import SealedMembrane
from pipeline.physics import lattice
from pipeline.physics.lattice import Lattice
from pipeline.sensors.parts import Bubble, DepthCamera
from pipeline.sensors.spec import SensorSpec

STEP_MM = 0.5  # under two pixels of the depth cameras in use; a quarter of the work of 0.25 mm
ATMOSPHERE_KPA = 101.325
TOLERANCE_MM = 1e-4
_PRESSURE_TOLERANCE = 2e-5  # of the gauge pressure: under a micrometre of the free membrane
# mean distance of the nearest clamped nodes beyond a curved rim, in lattice steps
_RIM_STEPS = 0.36
_KPA_TO_N_MM2 = 1e-3
N_HALVINGS = 4  # every lattice side is a multiple of 2^4 steps, so that it can be halved this often


@frozen
class BubbleContact:
    """State of the pressed bubble on its lattice."""

    # its deviation is negative toward the camera, positive where it bulges
    sealed: SealedMembrane
    contact_pressure_kpa: Doubles  # (ny, nx) of the object on the membrane
    contact: Mask  # (ny, nx) contact pressure > 0
    pressure_kpa: float  # gauge, inside
    force_n: float
    is_followed: bool  # from a start, not from rest

    @property
    def deviation_mm(self) -> Doubles | Floats:
        """Deviation (ny, nx) from the rest dome."""
        return self.sealed.deviation_mm

    @property
    def converged(self) -> bool:
        """Whether shape and pressure are found."""
        return self.sealed.converged


@frozen
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
    dome = (
        1.0
        - (on.x_mm()[None, :] / bubble.half_width_mm) ** 2
        - (on.y_mm()[:, None] / bubble.half_height_mm) ** 2
    )
    return bubble.height_mm * np.maximum(dome, 0.0)


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
    ceiling_mm: Reals,
    on: Lattice,
    *,
    tolerance_mm: float = TOLERANCE_MM,
    start: SealedMembrane | None = None,
) -> BubbleContact:
    """The bubble under an object at `ceiling_mm` (ny, nx) over the rim plane.

    Not finite = no object. From a `start` near by (a membrane of this lattice) it takes half the
    time, and shape and pressure are as near to the exact ones as from rest, but not the same bytes.
    """
    free = find_free_nodes(bubble, on)
    room = np.where(
        np.isfinite(ceiling_mm), ceiling_mm - compute_rest_height_mm(bubble, on), np.inf
    )
    grid = ObstacleProblem(clearance_mm=room, free=free, step_mm=on.step_mm)
    # kPa mm, so that load = pressure / tension is 1 / mm
    tension = compute_tension_n_per_mm(bubble) / _KPA_TO_N_MM2
    sealed = SealedMembrane(deviation_mm=freeze(np.zeros(on.shape)))
    is_followed = False
    if (room < 0).any():
        if start is not None and start.deviation_mm.shape == on.shape:
            sealed = _solve_sealed(bubble, grid, tension, tolerance_mm, start)
            is_followed = sealed.converged
        if not is_followed:
            half = grid.coarsen()  # a start at a quarter of the cost
            at_rest = SealedMembrane(deviation_mm=np.zeros(half.free.shape))
            rough = _solve_sealed(bubble, half, tension, tolerance_mm, at_rest)
            start = replace(rough, deviation_mm=refine(rough.deviation_mm))
            sealed = _solve_sealed(bubble, grid, tension, tolerance_mm, start)
    force = compute_contact_load(grid, sealed.deviation_mm, sealed.over_kpa / tension) * tension
    return BubbleContact(
        sealed=sealed,
        contact_pressure_kpa=freeze(force),
        contact=freeze(force > 0),
        pressure_kpa=bubble.pressure_kpa + sealed.over_kpa,
        force_n=float(force.sum()) * on.step_mm**2 * _KPA_TO_N_MM2,
        is_followed=is_followed,
    )


def compute_volume_mm3(bubble: Bubble) -> float:
    """Volume of air between the rim plane and the rest dome."""
    return 0.5 * math.pi * bubble.half_width_mm * bubble.half_height_mm * bubble.height_mm


def _solve_sealed(
    bubble: Bubble,
    grid: ObstacleProblem,
    tension: float,
    tolerance_mm: float,
    start: SealedMembrane,
) -> SealedMembrane:
    """Shape and pressure at which Boyle's law holds, from a start."""
    volume = compute_volume_mm3(bubble)
    air = bubble.dead_volume_mm3 + volume
    absolute = ATMOSPHERE_KPA + bubble.pressure_kpa
    # A pressure dp lifts the free membrane's volume by V dp / p; contact reduces this.
    steepest = 1.0 + absolute / air * volume / bubble.pressure_kpa
    sealed_air = (
        absolute / tension,
        air / grid.step_mm**2,
        1.0 / steepest,
        _PRESSURE_TOLERANCE * bubble.pressure_kpa / tension,
    )
    v, load, converged = solve_obstacle(
        grid,
        np.asarray(start.deviation_mm, np.float64),
        start.over_kpa / tension,
        tolerance_mm,
        sealed_air,
    )
    return SealedMembrane(deviation_mm=freeze(v), over_kpa=load * tension, converged=converged)


def solve_obstacle(
    grid: ObstacleProblem,
    start_mm: Doubles,
    load_per_mm: float,
    tolerance_mm: float,
    air: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
) -> tuple[Doubles, float, bool]:
    """(v, load, converged) under a uniform load, from a starting shape.

    With `air` (see the kernel) the load is that of sealed air, from a first guess.
    """
    from pipeline.physics import multigrid_kernels as kernels

    room = np.array(grid.clearance_mm, order="C")
    free = np.array(grid.free, order="C")
    v = np.where(free, np.minimum(start_mm, room), 0.0)
    load, converged = kernels.solve_obstacle(
        v,
        np.full_like(v, load_per_mm),
        room,
        free,
        grid.step_mm**2,
        grid.n_halvings,
        tolerance_mm,
        air,
    )
    return v, load, converged


def refine(v: Doubles | Floats) -> Doubles:
    """A shape on a halved grid, interpolated to the full one (bilinear)."""
    fine = np.empty((2 * v.shape[0] - 1, 2 * v.shape[1] - 1))
    fine[::2, ::2] = v
    fine[1::2, ::2] = 0.5 * (v[:-1] + v[1:])
    fine[:, 1::2] = 0.5 * (fine[:, :-2:2] + fine[:, 2::2])
    return fine


def compute_contact_load(grid: ObstacleProblem, v: Doubles | Floats, load_per_mm: float) -> Doubles:
    """Load (ny, nx) of the object on the membrane (1/mm), 0 outside contact."""
    force = np.zeros(v.shape)
    inner = (slice(1, -1), slice(1, -1))
    lap = (
        v[:-2, 1:-1] + v[2:, 1:-1] + v[1:-1, :-2] + v[1:-1, 2:] - 4.0 * v[inner]
    ) / grid.step_mm**2
    holds = grid.free[inner] & (v[inner] >= grid.clearance_mm[inner])
    force[inner] = np.where(holds, np.maximum(load_per_mm + lap, 0.0), 0.0)
    return force


_MIN_COSINE = 0.1  # noise is constant beyond 84 degrees, where there is no signal


def compute_ceiling_from_depth(sensor: SensorSpec, depth_mm: Reals, on: Lattice) -> Doubles:
    """Height (ny, nx) in mm over the rim plane of the surface in a depth image.

    +inf without a surface.
    """
    return lattice.rasterise_depth_image(sensor.camera, depth_mm, on) - get_rim_z_mm(sensor)


def compute_depth_from_deviation(sensor: SensorSpec, deviation_mm: Reals, on: Lattice) -> Doubles:
    """Z (rows, cols) where each camera ray meets the membrane.

    The rest depth itself where nothing deviates.
    """
    if not deviation_mm.any():
        return freeze(np.array(sensor.rest_depth_mm, dtype=np.float64))
    return lattice.intersect_rays(
        sensor.camera,
        compute_rest_z_mm(sensor, on) + deviation_mm,
        on,
        guess_mm=sensor.rest_depth_mm,
    )


def simulate_depth_frame(
    sensor: SensorSpec,
    depth_mm: Reals,
    seed: int | None,
    *,
    cosine: Reals | None = None,
) -> Floats:
    """The depth frame (rows, cols) float32 of a membrane; NaN = no value.

    With `seed` None it is the exact depth, else it has the errors of `sensor.depth_camera`, the
    same for the same seed. `cosine` (rows, cols) is that of the incidence, if it is known already.
    """
    errs = sensor.depth_camera
    if seed is None or sensor.bubble is None or errs is None:
        return freeze(depth_mm.astype(np.float32))
    rng = np.random.default_rng(seed)
    noise = _speckle(rng.standard_normal(depth_mm.shape, np.float32), errs.grain_px)
    exact = np.asarray(depth_mm, np.float64)
    if cosine is None:
        cosine = compute_incidence_cosine(sensor.camera, exact)
    sigma = sensor.bubble.depth_noise_mm * _relative_noise(exact, cosine, errs)
    usual = _relative_noise(sensor.rest_depth_mm, compute_rest_cosine(sensor), errs)
    sigma /= np.sqrt(np.mean(usual * usual))
    seen = _with_flying_pixels(exact, errs, rng) + sigma * noise
    lost = rng.random(depth_mm.shape) < errs.gap_share
    if errs.max_incidence_deg < 90.0:
        lost |= cosine < np.cos(np.deg2rad(errs.max_incidence_deg))
    if errs.step_mm > 0:
        seen = errs.step_mm * np.rint(seen / errs.step_mm)
    return freeze(np.where(lost, np.nan, seen).astype(np.float32))


def compute_incidence_cosine(camera: Camera, depth_mm: Reals) -> Doubles:
    """Cosine (rows, cols) of the angle between each ray and the surface normal.

    1 = perpendicular incidence.
    """
    points = camera.back_project(depth_mm)
    normal = compute_area_vectors(points)
    size = np.linalg.norm(normal, axis=2) * np.linalg.norm(points, axis=2)
    facing = np.abs(np.einsum("rcx,rcx->rc", normal, points))
    return np.divide(facing, size, out=np.zeros(depth_mm.shape), where=size > 0)


def compute_rest_cosine(sensor: SensorSpec) -> Doubles:
    """`compute_incidence_cosine` of the membrane at rest."""
    rest = sensor.rest_depth_mm
    return freeze(compute_incidence_cosine(sensor.camera, rest))


def _relative_noise(depth_mm: Doubles, cosine: Reals, errs: DepthCamera) -> Doubles:
    """Standard deviation (rows, cols) up to a factor.

    Distance in tenths of a metre, to stay near 1.
    """
    distance = np.abs(depth_mm) / 100.0
    return distance**errs.distance_power / np.maximum(cosine, _MIN_COSINE) ** errs.grazing_power


def _with_flying_pixels(depth_mm: Doubles, errs: DepthCamera, rng: np.random.Generator) -> Doubles:
    """The depth with flying pixels: mixtures of front and back where the depth jumps."""
    import cv2

    flies = rng.random(depth_mm.shape) < errs.flying_share
    share = rng.random(depth_mm.shape)
    # continues straight: a border is no jump
    framed = np.pad(depth_mm, 1, mode="reflect", reflect_type="odd")
    bend_x = np.abs(framed[1:-1, 2:] - 2 * depth_mm + framed[1:-1, :-2])
    bend_y = np.abs(framed[2:, 1:-1] - 2 * depth_mm + framed[:-2, 1:-1])
    jump = np.maximum(bend_x, bend_y) > errs.jump_mm
    if not jump.any():
        return depth_mm
    around = np.ones((3, 3), np.uint8)
    near, far = (np.asarray(f(depth_mm, around), np.float64) for f in (cv2.erode, cv2.dilate))
    return np.where(jump & flies, near + share * (far - near), depth_mm)


def _speckle(grain: Floats, width_px: float) -> Floats:
    """White noise blurred to the grain of a depth camera, of the same strength."""
    import cv2

    if width_px <= 0:
        return grain
    reach = max(1, round(4 * width_px))
    weights = np.asarray(cv2.getGaussianKernel(2 * reach + 1, width_px))[:, 0]
    # variance left by a blur along both axes, as a standard deviation
    keeps = float((weights**2).sum())
    return np.asarray(cv2.sepFilter2D(grain, cv2.CV_32F, weights, weights) / keeps, np.float32)


def get_rim_z_mm(sensor: SensorSpec) -> float:
    """Distance in mm of the rim plane from the camera."""
    return float(sensor.membrane.z_mm.min())


def compute_rest_z_mm(sensor: SensorSpec, on: Lattice) -> Doubles:
    """Z (ny, nx) in mm of the membrane at rest at the lattice's nodes."""
    return sensor.membrane.depth_at(on.x_mm()[None, :], on.y_mm()[:, None])
