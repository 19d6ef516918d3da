"""Small sensors and touches that are known exactly, quick enough to be made ten thousand times."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import Cloud, DepthMap, TargetDepth, make_pixel_index
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.alignment import Alignment, resolve_alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.target_depth.surface_projection import (
    PointSplatParams,
    ProjectionParams,
    SurfaceProjectionParams,
)

GELS = ("digit", "gelslim")
_SHARE = {"digit": 0.2, "gelslim": 0.15, "gelsight_mini": 0.15, "soft_bubble": 0.25}
KINDS = ("sphere", "rod", "plane", "flat", "ripple", "noise")  # of what is pressed in

unit_numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
seeds = st.integers(0, 2**32 - 1)


@lru_cache(maxsize=16)
def small(name: str, share: float | None = None) -> SensorSpec:
    """A sensor with fewer pixels over the same view."""
    whole = load_sensor(name)
    camera = whole.camera.scale(_SHARE[name] if share is None else share)
    return replace(whole, camera=camera, rest_depth_mm=whole.membrane.rest_depth_mm(camera))


def through(spec: SensorSpec, camera: Camera) -> SensorSpec:
    """The sensor with another camera."""
    return replace(spec, camera=camera, rest_depth_mm=spec.membrane.rest_depth_mm(camera))


def indentation_mm(spec: SensorSpec, kind: str, rng: np.random.Generator) -> np.ndarray:
    """A touch (rows, cols) of this kind on the sensor, anywhere in its view; 0 = not touched."""
    rows, cols = spec.camera.shape
    size = 0.35 * min(rows, cols)
    x = (np.arange(cols)[None, :] - rng.uniform(0.3, 0.7) * cols) / size
    y = (np.arange(rows)[:, None] - rng.uniform(0.3, 0.7) * rows) / size
    angle = rng.uniform(0, np.pi)
    across = np.cos(angle) * x + np.sin(angle) * y
    shape = {
        "sphere": 1 - x * x - y * y,
        "rod": 1 - across**2 + 0 * x * y,
        "plane": 0.6 + 0.4 * across,
        "flat": np.where(np.maximum(abs(x), abs(y)) < 1, 1.0, 0.0),
        "ripple": np.cos(6 * across) * (x * x + y * y < 1),
        "noise": rng.uniform(-1, 1, (rows, cols)) * (x * x + y * y < 1),
    }[kind]
    return np.maximum(shape, 0.0) * rng.uniform(0.1, 0.8) * spec.limits.indentation_max_mm


def depth_map(spec: SensorSpec, pushed_mm: np.ndarray) -> DepthMap:
    """What the depth stage would say of this indentation."""
    return DepthMap(
        indentation_mm=pushed_mm.astype(np.float32),
        depth_mm=(spec.rest_depth_mm - pushed_mm).astype(np.float32),
        contact=pushed_mm > 0,
        camera=spec.camera,
        source_index=make_pixel_index(spec.camera.shape),
    )


def view(spec: SensorSpec, pushed_mm: np.ndarray) -> TargetDepth:
    """What the project stage would say of this indentation, all of it seen by the source."""
    touched = pushed_mm > 0
    return TargetDepth(
        depth_mm=np.where(touched, spec.rest_depth_mm - pushed_mm, np.nan).astype(np.float32),
        contact=touched,
        indentation_mm=np.where(touched, pushed_mm, 0).astype(np.float32),
        camera=spec.camera,
        source_index=np.where(touched, make_pixel_index(spec.camera.shape), -1).astype(np.int32),
        in_view=np.ones(spec.camera.shape, bool),
    )


def touch(spec: SensorSpec, pushed_mm: np.ndarray) -> DepthMap:
    """The depth of a generated touch with this membrane."""
    return DepthMap(
        indentation_mm=pushed_mm.astype(np.float32),
        depth_mm=(spec.rest_depth_mm - pushed_mm).astype(np.float32),
        contact=pushed_mm > 0,
        camera=spec.camera,
        source_index=make_pixel_index(spec.camera.shape),
        in_view=np.ones(spec.camera.shape, bool),
    )


def cloud(points, grid=(50, 50), stride: int = 1) -> Cloud:
    """A cloud of these points on the first pixels of a grid."""
    points = np.asarray(points, np.float32).reshape(-1, 3)
    return Cloud(
        points_mm=points,
        source_index=np.arange(len(points), dtype=np.int32),
        grid_shape=grid,
        field_of_view_mm=np.array([[-9, -9, 20], [9, -9, 20], [9, 9, 20], [-9, 9, 20]], np.float32),
        stride=stride,
    )


@lru_cache(maxsize=64)
def frame(name: str, seed: int = 0, share: float | None = None) -> TactileFrame:
    """A pressed frame of a sensor by the simulator, with its noise."""
    spec = small(name, share)
    thing = mesh("ball")
    deep_mm = 0.35 * spec.limits.indentation_max_mm
    lowest_mm = float(thing.vertices_mm[:, 2].min())
    x, y = np.random.default_rng(seed).uniform(-1, 1, 2)
    pressed = simulate_press(thing, rigid.translation(x, y, -deep_mm - lowest_mm), spec, seed=seed)
    still = (
        optics.render_reference(spec)
        if spec.kind == "gel"
        else spec.rest_depth_mm.astype(np.float32)
    )
    return TactileFrame(sensor=name, image=pressed.image, reference=still)


@lru_cache(maxsize=8)
def mesh(kind: str) -> Mesh:
    """A ball of 8 mm, or a shape of the simulator."""
    return _ball(8.0) if kind == "ball" else shapes.make_shape(kind).mesh


def _ball(radius_mm: float, n: int = 48, m: int = 24) -> Mesh:
    polar = np.linspace(0, np.pi, m + 1)[:, None]
    around = np.arange(n)[None, :] * 2 * np.pi / n
    points = np.stack(
        [
            np.sin(polar) * np.cos(around),
            np.sin(polar) * np.sin(around),
            -np.cos(polar) + 0 * around,
        ],
        -1,
    )
    k = np.arange(m)[:, None] * n + np.arange(n)[None, :]
    right = np.arange(m)[:, None] * n + (np.arange(n)[None, :] + 1) % n
    faces = np.concatenate(
        [np.stack([k, right, k + n], -1), np.stack([right, right + n, k + n], -1)]
    )
    return Mesh(
        vertices_mm=radius_mm * points.reshape(-1, 3),
        triangles=faces.reshape(-1, 3).astype(np.int32),
    )


@st.composite
def rigid_motions(draw, mm: float, rad: float = np.pi):
    """A motion of up to `mm` along each axis and `rad` about any axis."""
    direction = np.array([draw(unit_numbers) for _ in range(3)])
    length = np.linalg.norm(direction)
    axis = direction / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])
    moved = rigid.rotation(axis * draw(st.floats(0.0, rad)))
    moved[:3, 3] = [mm * draw(unit_numbers) for _ in range(3)]
    return moved


def aligned(source: SensorSpec, target: SensorSpec) -> Alignment:
    """The alignment that the descriptions state."""
    return resolve_alignment(source, target)


def projection(mode: str, **limits) -> ProjectionParams:
    """The parameters of a way to draw; the paper's points have no limits."""
    return PointSplatParams() if mode == "paper" else SurfaceProjectionParams(**limits)
