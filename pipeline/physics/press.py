"""One press: what a sensor records of an object at a pose, and everything that is true of it.

The object's pose is given in the alignment frame, so that several sensors can feel the same press. Soft sensors must
be pressed deeper than stiff ones to feel as much (paper, dataset section): that is part of where a sensor stands in the
alignment frame, so that it is in every `target_from_source` too. A gel rests in the plane z = 0, the bubble's apex
stands `reach_mm` out of it; `soft_bubble.toml` says how far and why.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline import rigid
from pipeline.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.errors import SettingProblem
from pipeline.frames import Truth
from pipeline.meshes import Mesh
from pipeline.physics import bubble, bubble_camera, gel, lattice, optics
from pipeline.physics.lattice import Lattice
from pipeline.sensors.spec import SensorSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Press:
    """A simulated reading with its truth."""

    image: Image | Floats  # (rows, cols, 3) uint8, or (rows, cols) depth_mm
    truth: Truth
    force_n: float
    converged: bool


def press(thing: Mesh, alignment_from_object: Doubles, sensor: SensorSpec, *, seed: int | None) -> Press:
    """What `sensor` records of `thing` at this pose; `seed` is of its noise, None = no noise."""
    sensor_from_object = rigid.invert(sensor.alignment_from_sensor) @ alignment_from_object
    vertices = rigid.apply(sensor_from_object, thing.vertices_mm)
    solve = _gel if sensor.kind == "gel" else _bubble
    depth, contact, force_n, converged = solve(vertices, thing, sensor)
    indentation: Floats = freeze((sensor.rest_depth_mm - depth).astype(np.float32))
    truth = Truth(indentation_mm=indentation, contact=contact, sensor_from_object=freeze(sensor_from_object))
    image = photograph(sensor, indentation, depth, seed)
    return Press(image=image, truth=truth, force_n=force_n, converged=converged)


def reach_mm(sensor: SensorSpec) -> float:
    """How far the middle of the untouched sensor stands out of the plane z = 0 of the alignment frame.

    An object whose nearest point is at z = -d presses this sensor by d + reach.
    """
    apex = np.array([[0.0, 0.0, float(sensor.membrane.depth_at(0.0, 0.0))]])
    return float(rigid.apply(sensor.alignment_from_sensor, apex)[0, 2])


def photograph(sensor: SensorSpec, indentation_mm: Floats, depth_mm: Doubles, seed: int | None) -> Image | Floats:
    """The sensor's reading of a membrane at `depth_mm`, `indentation_mm` from rest, with its noise if seeded."""
    if sensor.kind == "gel":
        return optics.render(sensor, indentation_mm, seed=seed)
    return bubble_camera.reading(sensor, depth_mm, seed)


def _gel(vertices_mm: Doubles, thing: Mesh, sensor: SensorSpec) -> tuple[Doubles, Mask, float, bool]:
    if sensor.gel is None:
        raise SettingProblem(f"{sensor.name} has no gel to press; its description lacks [gel]")
    on = _gel_lattice(sensor)
    rest_z = float(np.median(sensor.rest_depth_mm))
    overlap = rest_z - lattice.nearest_of_mesh(vertices_mm, thing.triangles, on)
    answer = gel.press(sensor.gel, on.step_mm, overlap)
    if not answer.contact.any():
        return sensor.rest_depth_mm, freeze(np.zeros(sensor.camera.shape, np.bool_)), 0.0, answer.converged
    surface_z = rest_z - answer.indentation_mm.astype(np.float64)
    depth = lattice.depth_along_rays(sensor.camera, surface_z, on, guess_mm=sensor.rest_depth_mm)
    contact = lattice.seen_at_pixels(sensor.camera, answer.contact, on, depth)
    return depth, contact, answer.force_n, answer.converged


def _gel_lattice(sensor: SensorSpec) -> Lattice:
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


def _bubble(vertices_mm: Doubles, thing: Mesh, sensor: SensorSpec) -> tuple[Doubles, Mask, float, bool]:
    if sensor.bubble is None:
        raise SettingProblem(f"{sensor.name} has no membrane to press; its description lacks [bubble]")
    on = bubble.lattice(sensor.bubble)
    ceiling = lattice.nearest_of_mesh(vertices_mm, thing.triangles, on) - bubble_camera.rim_z_mm(sensor)
    answer = bubble.press(sensor.bubble, ceiling, on)
    depth = bubble_camera.depth_from_deviation(sensor, answer.deviation_mm, on)
    contact = lattice.seen_at_pixels(sensor.camera, answer.contact, on, depth)
    return depth, contact, answer.force_n, answer.converged
