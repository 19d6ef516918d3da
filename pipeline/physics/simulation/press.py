"""One press: the frame that a sensor records of an object at a pose, with its truth.

The object's pose is given in the alignment frame, so that several sensors record the same press.
Soft sensors are pressed deeper than stiff ones (paper, dataset section): the sensor's pose in the
alignment frame includes this, and so does every `target_from_source`. A gel rests in the plane z =
0, the bubble's apex stands out of it; `soft_bubble.toml` gives the distance and the reason.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import Truth
from pipeline.physics import bubble, gel, lattice, shear
from pipeline.physics.lattice import Lattice
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.shear import TangentialLoad
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable
from pipeline.sensors.spec import SensorSpec


@frozen
class SimulatedPress:
    """A simulated frame with its truth."""

    image: Image | Floats  # (rows, cols, 3) uint8, or (rows, cols) depth_mm
    truth: Truth
    force_n: float
    # False: the truth is wrong, also where a gel is pressed deeper than its thickness
    converged: bool
    # (rows, cols, 2) how far a tangential load moved the gel's surface along x and y
    shear_mm: Floats | None = None

    @property
    def indentation_mm(self) -> Floats:
        """True indentation (rows, cols)."""
        return cast("Floats", self.truth.indentation_mm)

    @property
    def contact(self) -> Mask:
        """True contact (rows, cols)."""
        return cast("Mask", self.truth.contact)

    @property
    def sensor_from_object(self) -> Doubles:
        """True pose (4, 4)."""
        return cast("Doubles", self.truth.sensor_from_object)


@frozen
class PressedSurface:
    """The surface of a pressed sensor."""

    depth_mm: Doubles  # (rows, cols)
    contact: Mask
    force_n: float
    converged: bool
    tangent_n: tuple[float, float] = (0.0, 0.0)  # right and down
    shear_mm: Floats | None = None


def simulate_press(
    mesh: Mesh,
    alignment_from_object: Doubles,
    sensor: SensorSpec,
    *,
    seed: int | None,
    load: TangentialLoad | None = None,
) -> SimulatedPress:
    """The frame that `sensor` records of an object at this pose.

    `seed` is that of the noise, None = no noise.

    `load` drags the object along a gel's surface; a bubble ignores it. Raises CalibrationError for
    a pose that is not rigid.
    """
    pose = rigid.validate_rigid(alignment_from_object, "the object's pose")
    sensor_from_object = rigid.invert(sensor.alignment_from_sensor) @ pose
    surface = press_membrane(mesh, sensor_from_object, sensor, load)
    indentation: Floats = freeze((sensor.rest_depth_mm - surface.depth_mm).astype(np.float32))
    truth = Truth(
        indentation_mm=indentation,
        contact=surface.contact,
        sensor_from_object=freeze(sensor_from_object),
        force_n=freeze(np.array([*surface.tangent_n, -surface.force_n])),
    )
    image = render_sensor_image(
        sensor, indentation, surface.depth_mm, seed, shear_mm=surface.shear_mm
    )
    return SimulatedPress(
        image=image,
        truth=truth,
        force_n=surface.force_n,
        converged=surface.converged,
        shear_mm=surface.shear_mm,
    )


def press_membrane(
    mesh: Mesh, sensor_from_object: Doubles, sensor: SensorSpec, load: TangentialLoad | None = None
) -> PressedSurface:
    """The surface of `sensor` under an object at this pose.

    Raises SettingProblem for a kind without a simulator.
    """
    simulate = PRESS_SIMULATORS.get(sensor.sensor_kind)
    if simulate is None:
        raise SettingProblem(
            f"sensors of kind {sensor.kind!r} such as {sensor.name} cannot be simulated"
        )
    return simulate(rigid.apply(sensor_from_object, mesh.vertices_mm), mesh, sensor, load)


def simulate_gel_press(
    vertices_mm: Doubles, mesh: Mesh, sensor: SensorSpec, load: TangentialLoad | None
) -> PressedSurface:
    """The surface of a gel pressed by a mesh at `vertices_mm` (n, 3) in the sensor frame."""
    if sensor.gel is None:
        raise SettingProblem(f"{sensor.name} has no [gel] in its description")
    on = make_gel_lattice(sensor)
    rest_z = float(np.median(sensor.rest_depth_mm))
    overlap = rest_z - lattice.rasterise_mesh(vertices_mm, mesh.triangles, on)
    answer = gel.press_gel(sensor.gel, on.step_mm, overlap)
    if not answer.contact.any():
        no_contact = freeze(np.zeros(sensor.camera.shape, np.bool_))
        return PressedSurface(
            depth_mm=sensor.rest_depth_mm,
            contact=no_contact,
            force_n=0.0,
            converged=answer.converged,
        )
    surface_z = rest_z - answer.indentation_mm.astype(np.float64)
    depth = lattice.intersect_rays(sensor.camera, surface_z, on, guess_mm=sensor.rest_depth_mm)
    contact = lattice.sample_mask_at_pixels(sensor.camera, answer.contact, on, depth)
    # Outside the view a long tool may lie deeper; the linear layer is accurate enough there.
    possible = float((sensor.rest_depth_mm - depth).max()) < sensor.gel.thickness_mm
    moved = None
    tangent_n = (0.0, 0.0)
    if load is not None:
        dragged = shear.solve_shear(sensor.gel, on.step_mm, answer.pressure_kpa, load)
        tangent_n = dragged.force_n
        moved = freeze(shear.sample_motion_at_pixels(sensor.camera, on, dragged.motion_mm, depth))
    return PressedSurface(
        depth_mm=depth,
        contact=contact,
        force_n=answer.force_n,
        converged=answer.converged and possible,
        tangent_n=tangent_n,
        shear_mm=moved,
    )


def move_bubble_closer(bubble: SensorSpec, by_mm: float) -> SensorSpec:
    """A bubble that stands `by_mm` closer to the object than described."""
    moved: Doubles = freeze(rigid.translation(0.0, 0.0, by_mm) @ bubble.alignment_from_sensor)
    return replace(bubble, alignment_from_sensor=moved)


def make_gel_lattice(sensor: SensorSpec) -> Lattice:
    """Lattice of the pad: the image's grid at rest, extended by the thickness on every side."""
    assert sensor.gel is not None
    step = sensor.pixel_mm
    camera = sensor.camera
    margin = math.ceil(sensor.gel.thickness_mm / step)
    return Lattice(
        x0_mm=-(camera.cx_px + margin) * step,
        y0_mm=-(camera.cy_px + margin) * step,
        step_mm=step,
        shape=(camera.rows + 2 * margin, camera.cols + 2 * margin),
    )


def simulate_bubble_press(
    vertices_mm: Doubles, mesh: Mesh, sensor: SensorSpec, _load: TangentialLoad | None
) -> PressedSurface:
    """The membrane of a bubble pressed by a mesh at `vertices_mm` (n, 3) in the sensor frame."""
    if sensor.bubble is None:
        raise SettingProblem(f"{sensor.name} has no [bubble] in its description")
    # no finer than the camera sees
    on = bubble.make_lattice(sensor.bubble, max(bubble.STEP_MM, sensor.pixel_mm))
    ceiling = lattice.rasterise_mesh(vertices_mm, mesh.triangles, on) - bubble.get_rim_z_mm(sensor)
    answer = bubble.press_bubble(sensor.bubble, ceiling, on)
    depth = bubble.compute_depth_from_deviation(sensor, answer.deviation_mm, on)
    contact = lattice.sample_mask_at_pixels(sensor.camera, answer.contact, on, depth)
    return PressedSurface(
        depth_mm=depth, contact=contact, force_n=answer.force_n, converged=answer.converged
    )


# (vertices_mm (n, 3) in the sensor frame, mesh, sensor, load) -> surface
PressSurface = Callable[[Doubles, Mesh, SensorSpec, TangentialLoad | None], PressedSurface]
PRESS_SIMULATORS: KindTable[PressSurface] = KindTable(
    {GelSensor: simulate_gel_press, BubbleSensor: simulate_bubble_press}
)
