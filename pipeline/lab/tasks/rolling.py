"""A ball between a gel plate that moves in two slides and a cover that presses it onto the gel.

The plate's top is z = 0 of the world; the plate's frame has its axes and the centre of the gel as
origin. Without slip the ball follows the plate by half, so that it rolls by half the plate's motion
backwards over the gel.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.lab.tasks.scene import GRAVITY_MM_S2, Scene, write_box, write_pose
from pipeline.lab.tasks.task import Tick
from pipeline.physics.simulation.shapes.solids import revolve_profile

# a glass marble of 16 mm, as the shape `marble`
RADIUS_MM = 8.0
BALL_KG = 0.0055
# of rubber on glass; rolling: torque over normal force
FRICTION = 0.6
SPIN_FRICTION_MM = 1.0
ROLLING_FRICTION_MM = 0.1
TICK_S = 0.1
_PLATE_KG = 0.2
_PLATE_STIFFNESS_N_M = 4000.0
_DAMPING_RATIO = 1.0
# halves of plate and cover
_PLATE_HALF_MM = 40.0
_COVER_HALF_MM = 60.0
_THICK_MM = 2.0
_LEAST_KG = 1e-4  # of a cover: MuJoCo wants one
_N_SIDES = 128  # of the mesh: chords within 3 um of the ball


@derive_once
def make_ball() -> Mesh:
    """The ball about its centre."""
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _N_SIDES // 2 + 1)
    return revolve_profile(
        RADIUS_MM * np.column_stack([np.cos(angle), np.sin(angle)]), _N_SIDES, "marble"
    )


class RollingBall:
    """A ball that starts at rest at a place on the plate, and the plate's slides."""

    def __init__(self, start_mm: tuple[float, float], load_n: float) -> None:
        """`start_mm` is the contact in the plate's frame, `load_n` the force of plate and ball
        on each other.
        """
        contact = (
            f'condim="6" friction="{FRICTION} {1e-3 * SPIN_FRICTION_MM} '
            f'{1e-3 * ROLLING_FRICTION_MM}"'
        )
        cover_kg = max(0.0, load_n / (1e-3 * GRAVITY_MM_S2) - BALL_KG)
        plate, cover = (
            write_box(
                (half, half, _THICK_MM),
                rigid.translation(0.0, 0.0, z),
                f'mass="{mass!r}" {contact}',
            )
            for half, z, mass in (
                (_PLATE_HALF_MM, -_THICK_MM, _PLATE_KG),
                (_COVER_HALF_MM, 2.0 * RADIUS_MM + _THICK_MM, max(cover_kg, _LEAST_KG)),
            )
        )
        damping = 2.0 * _DAMPING_RATIO * math.sqrt(_PLATE_STIFFNESS_N_M * _PLATE_KG)
        slides = "".join(
            f'<joint name="plate_{axis}" type="slide" axis="{vector}"/>' for axis, vector in _SLIDES
        )
        servos = "".join(
            f'<position name="plate_{axis}" joint="plate_{axis}" kp="{_PLATE_STIFFNESS_N_M}" '
            f'kv="{damping!r}"/>'
            for axis, _ in _SLIDES
        )
        self._scene = Scene(
            f'<body name="plate">{slides}{plate}</body>'
            f'<body name="ball" {write_pose(rigid.translation(*start_mm, RADIUS_MM))}><freejoint/>'
            f'<geom type="sphere" size="{1e-3 * RADIUS_MM}" mass="{BALL_KG}" {contact}/></body>'
            f'<body name="cover"><joint type="slide" axis="0 0 1"/>{cover}</body>',
            extra_xml=f"<actuator>{servos}</actuator>",
        )
        self._commanded_mm = np.zeros(2)

    @property
    def plate_from_ball(self) -> Doubles:
        """Pose (4, 4) of the ball's centre in the plate's frame."""
        return rigid.invert(self._scene.get_pose("plate")) @ self._scene.get_pose("ball")

    @property
    def contact_mm(self) -> Doubles:
        """(2,) where the ball touches the gel, in the plate's frame."""
        return self.plate_from_ball[:2, 3]

    def move_plate(self, step_mm: Doubles) -> Tick:
        """Move the plate by (2,) mm within one tick."""
        n_parts = 5
        for _ in range(n_parts):
            self._commanded_mm += step_mm / n_parts
            for (axis, _), value in zip(_SLIDES, self._commanded_mm, strict=True):
                self._scene.command(f"plate_{axis}", 1e-3 * float(value))
            self._scene.advance(TICK_S / n_parts)
        return Tick(
            time_s=self._scene.time_s,
            world_from_object=self._scene.get_pose("ball"),
            world_from_hand=self._scene.get_pose("plate"),
            commanded=rigid.translation(
                float(self._commanded_mm[0]), float(self._commanded_mm[1]), 0.0
            ),
            force_n=self._scene.measure_contact_force("ball", "plate"),
        )


_SLIDES = (("x", "1 0 0"), ("y", "0 1 0"))
