"""A MuJoCo scene in millimetres: bodies from text, steps, poses and contact forces.

MuJoCo computes in SI units; everything here is converted at its border. `<worldbody>` and what else
a task needs is its own MJCF text with lengths in metres, made by the functions below.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.errors import SettingProblem

STEP_S = 5e-4
GRAVITY_MM_S2 = 9810.0
SOLREF = "0.001 1"  # contacts as stiff as two steps allow


def _import_mujoco() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise SettingProblem(
            "tasks need MuJoCo: install it with `pip install 'tactoscope[tasks]'`"
        ) from error
    return mujoco


class Scene:
    """A simulated scene and its state."""

    def __init__(
        self, body_xml: str, *, extra_xml: str = "", meshes_mm: dict[str, Doubles] | None = None
    ) -> None:
        """`body_xml` is the inside of `<worldbody>`.

        `meshes_mm` are convex hulls by name, each of points (n, 3).
        """
        self._mujoco = _import_mujoco()
        assets = "".join(
            f'<mesh name="{name}" vertex="{_join((1e-3 * points).ravel())}" inertia="convex"/>'
            for name, points in (meshes_mm or {}).items()
        )
        xml = (
            f'<mujoco><option timestep="{STEP_S}" gravity="0 0 {-1e-3 * GRAVITY_MM_S2}" '
            'cone="elliptic" '
            f'integrator="implicitfast" impratio="10"/><compiler angle="radian" autolimits="true"/>'
            f'<default><geom solref="{SOLREF}" solimp="0.99 0.999 0.0001"/></default>'
            f"<asset>{assets}</asset><worldbody>{body_xml}</worldbody>{extra_xml}</mujoco>"
        )
        self._model = self._mujoco.MjModel.from_xml_string(xml)
        self._data = self._mujoco.MjData(self._model)
        self._mujoco.mj_forward(self._model, self._data)

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self._data.time)

    def advance(self, duration_s: float) -> None:
        """Step for this long with the commands as they are."""
        for _ in range(max(1, round(duration_s / STEP_S))):
            self._mujoco.mj_step(self._model, self._data)

    def command(self, name: str, value: float) -> None:
        """Set an actuator's command, in SI units."""
        self._data.actuator(name).ctrl[0] = value

    def move_mocap(self, name: str, world_from_body: Doubles) -> None:
        """Command the pose of a mocap body."""
        quaternion = np.zeros(4)
        self._mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(world_from_body[:3, :3]).ravel())
        k = int(self._model.body(name).mocapid[0])
        self._data.mocap_pos[k] = 1e-3 * world_from_body[:3, 3]
        self._data.mocap_quat[k] = quaternion

    def release(self, equality: str) -> None:
        """Switch an equality constraint off."""
        self._data.eq_active[int(self._model.equality(equality).id)] = 0

    def get_pose(self, body: str) -> Doubles:
        """world_from_body (4, 4) in mm."""
        found = self._data.body(body)
        pose = np.eye(4)
        pose[:3, :3] = np.array(found.xmat).reshape(3, 3)
        pose[:3, 3] = 1e3 * np.array(found.xpos)
        return pose

    def measure_contact_force(self, body: str, other: str = "") -> Doubles:
        """Force (3,) in N that the contacts with one other body, or with all, exert on a body,
        in the world.
        """
        total = np.zeros(3)
        one = np.zeros(6)
        wanted = int(self._model.body(body).id)
        partner = int(self._model.body(other).id) if other else -1
        for k in range(int(self._data.ncon)):
            contact = self._data.contact[k]
            bodies = [int(self._model.geom_bodyid[geom]) for geom in contact.geom]
            if wanted in bodies and bodies[0] != bodies[1] and (partner < 0 or partner in bodies):
                self._mujoco.mj_contactForce(self._model, self._data, k, one)
                # the frame's first axis points from body 1 to body 2
                sign = 1.0 if bodies[1] == wanted else -1.0
                total += sign * (np.array(contact.frame).reshape(3, 3).T @ one[:3])
        return total


def write_box(half_mm: Sequence[float], world_from_box: Doubles, attributes: str = "") -> str:
    """MJCF of a box geom."""
    return (
        f'<geom type="box" size="{_join(1e-3 * np.asarray(half_mm))}" '
        f"{write_pose(world_from_box)} {attributes}/>"
    )


def write_pose(parent_from_child: Doubles) -> str:
    """MJCF attributes of a pose."""
    x = parent_from_child[:3, 0]
    y = parent_from_child[:3, 1]
    return f'pos="{_join(1e-3 * parent_from_child[:3, 3])}" xyaxes="{_join(x)} {_join(y)}"'


def write_compliant_joints(
    name: str, stiffness_n_mm: float, stiffness_nmm_rad: float, mass_kg: float
) -> tuple[str, str]:
    """(joints, actuators) of an impedance-controlled hand: six position servos `{name}_x` ...
    `{name}_rz`.

    Each is critically damped for this mass, and for its inertia with a radius of gyration of 20 mm.
    """
    joints = []
    actuators = []
    for kind, stiffness, inertia in (
        ("slide", 1e3 * stiffness_n_mm, mass_kg),
        ("hinge", 1e-3 * stiffness_nmm_rad, mass_kg * 0.02**2),
    ):
        for k, axis in enumerate("xyz"):
            joint = f"{name}_{axis}" if kind == "slide" else f"{name}_r{axis}"
            vector = _join(np.eye(3)[k])
            joints.append(f'<joint name="{joint}" type="{kind}" axis="{vector}"/>')
            damping = 2.0 * float(np.sqrt(stiffness * inertia))
            actuators.append(
                f'<position name="{joint}" joint="{joint}" kp="{stiffness!r}" kv="{damping!r}"/>'
            )
    return "".join(joints), f"<actuator>{''.join(actuators)}</actuator>"


def _join(values: Sequence[float] | Doubles) -> str:
    return " ".join(repr(float(v)) for v in values)
