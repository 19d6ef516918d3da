"""One press: what a sensor records of an object at a pose, and everything that is true of it.

The object's pose is given in the alignment frame, so that several sensors can feel the same press. Soft sensors must
be pressed deeper than stiff ones to feel as much (paper, dataset section): that is part of where a sensor stands in the
alignment frame, so that it is in every `target_from_source` too. A gel rests in the plane z = 0, the bubble's apex
stands out of it; `soft_bubble.toml` says how far and why.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.base.entry_points import load_reference
from pipeline.base.errors import SettingProblem
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.physics import bubble, bubble_camera, gel, lattice, optics, shear
from pipeline.physics.lattice import Lattice
from pipeline.physics.shear import TangentialLoad
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import Truth


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedPress:
    """A simulated reading with its truth."""

    image: Image | Floats  # (rows, cols, 3) uint8, or (rows, cols) depth_mm
    truth: Truth
    force_n: float
    converged: bool  # False: the truth is not to be trusted, also where a gel was pressed deeper than it is thick
    shear_mm: Floats | None = None  # (rows, cols, 2) how far a tangential load moved the gel's surface along x and y


@dataclass(frozen=True, slots=True, kw_only=True)
class _Felt:
    """The surface of a pressed sensor."""

    depth_mm: Doubles  # (rows, cols)
    contact: Mask
    force_n: float
    converged: bool
    tangent_n: tuple[float, float] = (0.0, 0.0)  # right and down
    shear_mm: Floats | None = None


def simulate_press(
    thing: Mesh,
    alignment_from_object: Doubles,
    sensor: SensorSpec,
    *,
    seed: int | None,
    load: TangentialLoad | None = None,
) -> SimulatedPress:
    """What `sensor` records of `thing` at this pose; `seed` is of its noise, None = no noise.

    `load` drags the object along a gel's surface (a bubble does not feel it). Raises CalibrationError for a pose that
    is no rigid transform.
    """
    pose = rigid.validate_rigid(alignment_from_object, "the object's pose")
    sensor_from_object = rigid.invert(sensor.alignment_from_sensor) @ pose
    vertices = rigid.apply(sensor_from_object, thing.vertices_mm)
    felt = _press_membrane(vertices, thing, sensor, load)
    indentation: Floats = freeze((sensor.rest_depth_mm - felt.depth_mm).astype(np.float32))
    truth = Truth(
        indentation_mm=indentation, contact=felt.contact, sensor_from_object=freeze(sensor_from_object),
        force_n=freeze(np.array([*felt.tangent_n, -felt.force_n])),
    )  # fmt: skip
    image = render_sensor_image(sensor, indentation, felt.depth_mm, seed, shear_mm=felt.shear_mm)
    return SimulatedPress(
        image=image, truth=truth, force_n=felt.force_n, converged=felt.converged, shear_mm=felt.shear_mm
    )


def render_sensor_image(
    sensor: SensorSpec, indentation_mm: Floats, depth_mm: Doubles, seed: int | None, *, shear_mm: Floats | None = None
) -> Image | Floats:
    """The sensor's reading of a membrane at `depth_mm`, `indentation_mm` from rest, with its noise if seeded."""
    return sensor.sensor_kind.simulate_image(sensor, indentation_mm, depth_mm, seed, shear_mm)


def simulate_gel_image(
    sensor: SensorSpec, indentation_mm: Floats, _depth_mm: Doubles, seed: int | None, shear_mm: Floats | None
) -> Image:
    """The image of a gel."""
    return optics.render(sensor, indentation_mm, seed=seed, shear_mm=shear_mm)


def simulate_bubble_image(
    sensor: SensorSpec, _indentation_mm: Floats, depth_mm: Doubles, seed: int | None, _shear_mm: Floats | None
) -> Floats:
    """The depth image of a bubble."""
    return bubble_camera.simulate_depth_frame(sensor, depth_mm, seed)


def _press_membrane(vertices_mm: Doubles, thing: Mesh, sensor: SensorSpec, load: TangentialLoad | None) -> _Felt:
    simulator = sensor.sensor_kind.press_simulator
    if not simulator:
        raise SettingProblem(f"sensors of kind {sensor.kind!r} such as {sensor.name} cannot be simulated")
    return load_reference(simulator)(vertices_mm, thing, sensor, load)


def simulate_gel_press(vertices_mm: Doubles, thing: Mesh, sensor: SensorSpec, load: TangentialLoad | None) -> _Felt:
    """The surface of a gel pressed by a mesh at `vertices_mm` (n, 3) in the sensor frame."""
    if sensor.gel is None:
        raise SettingProblem(f"{sensor.name} has no gel to press; its description lacks [gel]")
    on = make_gel_lattice(sensor)
    rest_z = float(np.median(sensor.rest_depth_mm))
    overlap = rest_z - lattice.rasterise_mesh(vertices_mm, thing.triangles, on)
    answer = gel.press_gel(sensor.gel, on.step_mm, overlap)
    if not answer.contact.any():
        nowhere = freeze(np.zeros(sensor.camera.shape, np.bool_))
        return _Felt(depth_mm=sensor.rest_depth_mm, contact=nowhere, force_n=0.0, converged=answer.converged)
    surface_z = rest_z - answer.indentation_mm.astype(np.float64)
    depth = lattice.intersect_rays(sensor.camera, surface_z, on, guess_mm=sensor.rest_depth_mm)
    contact = lattice.sample_mask_at_pixels(sensor.camera, answer.contact, on, depth)
    # Beside the view a long tool's end may lie deeper; a linear layer answers for that well enough.
    possible = float((sensor.rest_depth_mm - depth).max()) < sensor.gel.thickness_mm
    moved, tangent_n = None, (0.0, 0.0)
    if load is not None:
        dragged = shear.solve_shear(sensor.gel, on.step_mm, answer.pressure_kpa, load)
        tangent_n, moved = (
            dragged.force_n,
            freeze(shear.sample_motion_at_pixels(sensor.camera, on, dragged.motion_mm, depth)),
        )
    return _Felt(
        depth_mm=depth, contact=contact, force_n=answer.force_n, converged=answer.converged and possible,
        tangent_n=tangent_n, shear_mm=moved,
    )  # fmt: skip


def make_gel_lattice(sensor: SensorSpec) -> Lattice:
    """The pad on the picture's own grid at rest, and a thickness more on every side."""
    assert sensor.gel is not None
    step, camera = sensor.pixel_mm, sensor.camera
    margin = math.ceil(sensor.gel.thickness_mm / step)
    return Lattice(
        x0_mm=-(camera.cx_px + margin) * step,
        y0_mm=-(camera.cy_px + margin) * step,
        step_mm=step,
        shape=(camera.rows + 2 * margin, camera.cols + 2 * margin),
    )


def simulate_bubble_press(vertices_mm: Doubles, thing: Mesh, sensor: SensorSpec, _load: TangentialLoad | None) -> _Felt:
    """The membrane of a bubble pressed by a mesh at `vertices_mm` (n, 3) in the sensor frame."""
    if sensor.bubble is None:
        raise SettingProblem(f"{sensor.name} has no membrane to press; its description lacks [bubble]")
    on = bubble.make_lattice(sensor.bubble)
    ceiling = lattice.rasterise_mesh(vertices_mm, thing.triangles, on) - bubble_camera.get_rim_z_mm(sensor)
    answer = bubble.press_bubble(sensor.bubble, ceiling, on)
    depth = bubble_camera.compute_depth_from_deviation(sensor, answer.deviation_mm, on)
    contact = lattice.sample_mask_at_pixels(sensor.camera, answer.contact, on, depth)
    return _Felt(depth_mm=depth, contact=contact, force_n=answer.force_n, converged=answer.converged)
