"""Shear force on a gel, from the motion of its printed markers and the pressure of the contact.

The traction is t(x) = p(x) (c + e(x)): the pressure p by the contact model, times one vector c of
the whole contact and a deviation e of each cell, all independent and normal with mean 0. Markers
move by the layer's linear response to t (`shear.make_response`), by a shift of the whole image, and
by noise, so that t has a closed form (kriging); its integral is the force. Markers that jumped to a
neighbour, or that pressing moved otherwise than modelled, lose weight with their residual
(Student's t, by reweighting). Motion out of a dent is even around the contact and therefore adds no
force, whatever its size.
"""

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.physics.contact_force import PressedCells
from pipeline.physics.shear import make_response
from pipeline.sensors.parts import Gel

# No constant matters much: half or twice as much of each moves the median error by 0.3 % of the
# normal force, the 90th percentile by 1 % (40 presses of training objects on varied GelSlims).
# Without c, errors double.
_RATIO = 0.5  # standard deviation of c and e
_NOISE_MM = 0.013  # of a marker's measured motion: 0.3 px of a GelSlim, simulated
_SHIFT_MM = 0.05  # of the whole image
_FREEDOM = 4.0  # degrees of freedom of Student's t
_REWEIGHTINGS = 10
# more are grains of a noisy image, and take minutes
_MARKERS_MIN = 4
_MARKERS_MAX = 1000
_KPA_TO_N_MM2 = 1e-3


@frozen
class MarkerMotion:
    """Motion of printed markers since the reference image; right and down."""

    places_mm: Doubles  # (n, 2) in the frame's image, from its upper left corner
    motion_mm: Doubles  # (n, 2)


def estimate_shear_force(
    gel: Gel, pressed: PressedCells, markers: MarkerMotion
) -> tuple[float, float] | None:
    """(right, down) in N of the traction that moves the markers.

    None with too few markers, or too many.

    The motion is that by the traction alone: without what pressing explains.
    """
    n = len(markers.places_mm)
    if not _MARKERS_MIN <= n <= _MARKERS_MAX:
        return None
    inside = pressed.pressure_kpa > 0
    if not inside.any():
        return 0.0, 0.0
    response = _compute_responses(gel, pressed, markers, inside)
    scale_kpa = _RATIO * pressed.pressure_kpa[inside].astype(np.float64)
    weighted = response * np.repeat(scale_kpa, 2)  # motion by e = 1 of each cell
    common = weighted.reshape(2 * n, -1, 2).sum(axis=1)  # motion by c = 1
    shift = _SHIFT_MM * np.tile(np.eye(2), (n, 1))
    explained = weighted @ weighted.T + common @ common.T + shift @ shift.T
    moved = markers.motion_mm.ravel()
    noise = np.full(2 * n, _NOISE_MM**2)
    solution = np.zeros(2 * n)
    for _ in range(_REWEIGHTINGS):
        solution = np.linalg.solve(explained + np.diag(noise), moved)
        squared = ((noise * solution).reshape(n, 2) ** 2).sum(axis=1) / _NOISE_MM**2
        noise = np.repeat(_NOISE_MM**2 * (_FREEDOM + squared) / (_FREEDOM + 2), 2)
    # e + c, over their standard deviation
    ratio = (weighted.T @ solution).reshape(-1, 2) + common.T @ solution
    force = (scale_kpa[:, None] * ratio).sum(axis=0) * pressed.cell_mm**2 * _KPA_TO_N_MM2
    return float(force[0]), float(force[1])


def _compute_responses(
    gel: Gel, pressed: PressedCells, markers: MarkerMotion, inside: Mask
) -> Doubles:
    """Motion (2 n, 2 cells) in mm of each marker by 1 kPa of traction, right and down, on each
    pressed cell.
    """
    import cv2

    shape = (int(pressed.pressure_kpa.shape[0]), int(pressed.pressure_kpa.shape[1]))
    impulses = _compute_impulse_responses(gel, pressed.cell_mm, shape)
    places = markers.places_mm / pressed.cell_mm - 0.5 + pressed.margin_cells
    cells = np.argwhere(inside)
    away = [
        (places[:, 1 - axis][:, None] - cells[:, axis] + shape[axis]).astype(np.float32)
        for axis in (1, 0)
    ]
    out = np.empty((len(places), 2, len(cells), 2))
    for axis, impulse in enumerate(impulses):
        out[:, :, :, axis] = np.moveaxis(
            cv2.remap(impulse, away[0], away[1], cv2.INTER_LINEAR), -1, 1
        )
    return out.reshape(2 * len(places), 2 * len(cells))


@derive_once
def _compute_impulse_responses(
    gel: Gel, cell_mm: float, shape: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Motion (2 rows, 2 cols, 2) around a cell with 1 kPa of traction to the right, and down."""
    rows, cols = shape
    response = make_response(gel, cell_mm, (2 * rows, 2 * cols))
    impulse = np.zeros((2, 2 * rows, 2 * cols, 2), np.float32)
    impulse[0, rows, cols, 0] = impulse[1, rows, cols, 1] = 1.0
    right, down = (freeze(response.compute_motion(one)) for one in impulse)
    return right, down
