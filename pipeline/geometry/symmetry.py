"""Which turns map an object onto itself, so that a pose error does not punish what nobody could feel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import SettingProblem
from pipeline.geometry import rigid

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
_ALONG_Z = 0.99
_SAME = 1e-9  # entries of two rotation matrices that are one


@dataclass(frozen=True, slots=True, kw_only=True)
class Symmetry:
    """Rotations about the object's origin that leave its surface where it is."""

    rotations: Doubles  # (n, 3, 3), the identity first
    axis: Doubles | None = None  # (3,) unit: any turn about it is a symmetry too; None = there is none

    @property
    def fold(self) -> int:
        """How many turns about z leave it as it is; 0 = all of them."""
        if self.axis is not None and abs(float(self.axis[2])) > _ALONG_Z:
            return 0
        return sum(abs(float(turn[2, 2]) - 1.0) < _SAME for turn in self.rotations)

    def sample_rotations(self, step: float = 0.01) -> Doubles:
        """All rotations (m, 3, 3), the identity first, for the MSSD of the BOP challenge (Hodan et al. 2020).

        Between neighbouring turns about the axis no point of the object moves more than `step` of its diameter.
        Raises SettingProblem when the step is not positive.
        """
        if not step > 0:
            raise SettingProblem(f"the step of a symmetry must be above 0, got {step!r}")
        if self.axis is None:
            return self.rotations
        # What an axis turns lies within half a diameter of it, so 2 step radians move it by step diameters at most.
        turned = _about(tuple(self.axis), max(1, math.ceil(math.pi / step)))
        return freeze((self.rotations[:, None] @ turned[None]).reshape(-1, 3, 3))


def asymmetric() -> Symmetry:
    """Of an object that looks different from everywhere."""
    return Symmetry(rotations=freeze(np.eye(3)[None].copy()))


def cyclic(n: int, axis: Sequence[float] = Z) -> Symmetry:
    """Of an object that looks the same after each n-th of a turn."""
    return Symmetry(rotations=freeze(_about(axis, n)))


def revolution(axis: Sequence[float] = Z, flip: Sequence[float] | None = None) -> Symmetry:
    """Of a body of revolution; with `flip`, of one whose ends are alike."""
    discrete = np.eye(3)[None].copy() if flip is None else _about(flip, 2)
    return Symmetry(rotations=freeze(discrete), axis=freeze(np.array(axis, dtype=np.float64)))


def _about(axis: Sequence[float], n: int) -> Doubles:
    unit = np.asarray(axis, dtype=np.float64)
    turns = np.stack([rigid.rotation(2.0 * math.pi * k / n * unit)[:3, :3] for k in range(n)])
    turns[np.abs(turns) < _SAME] = 0.0
    return turns
