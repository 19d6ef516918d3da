"""Rotations that map an object onto itself, which pose errors do not count."""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid

X = (1.0, 0.0, 0.0)
Z = (0.0, 0.0, 1.0)
_ALONG_Z = 0.99
_ROUNDING = 1e-9  # difference of entries of two equal rotation matrices


@frozen
class Symmetry:
    """Rotations about the object's origin that leave its surface in place."""

    rotations: Doubles  # (n, 3, 3), the identity first
    # (3,) unit: any rotation about it is a symmetry too; None = no such axis
    axis: Doubles | None = None

    @property
    def fold(self) -> int:
        """Return the number of rotations about z that leave it in place; 0 = all of them."""
        if self.axis is not None and abs(float(self.axis[2])) > _ALONG_Z:
            return 0
        return sum(abs(float(turn[2, 2]) - 1.0) < _ROUNDING for turn in self.rotations)

    def sample_rotations(self, step: float = 0.01) -> Doubles:
        """Return all rotations (m, 3, 3), the identity first, for the MSSD of the BOP challenge
        (Hodan et al. 2020).

        Between neighbouring rotations about the axis no point of the object moves more than `step`
        of its diameter. Raises SettingProblem when the step is not positive.
        """
        if not step > 0:
            raise SettingProblem(f"the step of a symmetry must be above 0, got {step!r}")
        if self.axis is None:
            return self.rotations
        # Points are within half a diameter of the axis, so 2 step radians move them by step
        # diameters at most.
        turned = _about(tuple(self.axis), max(1, math.ceil(math.pi / step)))
        return freeze((self.rotations[:, None] @ turned[None]).reshape(-1, 3, 3))


def asymmetric() -> Symmetry:
    """Return the symmetry of an object without one."""
    return Symmetry(rotations=freeze(np.eye(3)[None].copy()))


def cyclic(n: int, axis: Sequence[float] = Z) -> Symmetry:
    """Return the symmetry of an object with `n` equal rotations about an axis."""
    return Symmetry(rotations=freeze(_about(axis, n)))


def revolution(axis: Sequence[float] = Z, flip: Sequence[float] | None = None) -> Symmetry:
    """Return the symmetry of a body of revolution; with `flip`, of one with equal ends."""
    discrete = np.eye(3)[None].copy() if flip is None else _about(flip, 2)
    return Symmetry(rotations=freeze(discrete), axis=freeze(np.array(axis, dtype=np.float64)))


def _about(axis: Sequence[float], n: int) -> Doubles:
    unit = np.asarray(axis, dtype=np.float64)
    turns = np.stack([rigid.rotation(2.0 * math.pi * k / n * unit)[:3, :3] for k in range(n)])
    turns[np.abs(turns) < _ROUNDING] = 0.0
    return turns
