"""Normal force of a measured touch: its contact as a rigid object, pressed into the described gel
or membrane.

The surface in contact has the object's shape, so pressing that shape gives the contact's pressure
(`gel.press_gel`, `bubble.press_bubble`), whose integral is the force. Stiffness, thickness and air
pressure are the description's: of one sensor instance, the force is known up to a scale, which
weighings determine (`calibration.force_scale`).
"""

import math

import numpy as np

from pipeline.core.arrays import Floats, Mask
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import bubble, gel
from pipeline.sensors.spec import SensorSpec

_GEL_STEP_MM = 0.25  # an eighth of a gel's thickness; 0.1 mm changes a force by 0.2 %
_BUBBLE_STEP_MM = 1.0  # 0.5 mm takes four times as long and changes a force by 0.6 %
_TOLERANCE_MM = 1e-3  # a tenth of the best depth error
_COVERED_SHARE = 0.5  # of a coarse cell, from which it is in contact


@frozen
class ContactForce:
    """Force of a contact by the contact model; of one sensor instance up to a scale."""

    normal_n: float
    # along the surface, right and down; None = not measured
    shear_n: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()


@frozen
class PressedCells:
    """Pressure of a contact on square cells that reach beyond the image on every side."""

    pressure_kpa: Floats  # (rows, cols)
    force_n: float
    cell_mm: float
    margin_cells: int  # beyond the image


def press_gel_contact(sensor: SensorSpec, indentation_mm: Floats, contact: Mask) -> PressedCells:
    """The pressure of a contact (rows, cols) with the described gel.

    `indentation_mm` is finite in contact.

    A contact at the image border is continued by half of the pad beyond the view, since it ends
    somewhere there.
    """
    import cv2

    assert sensor.gel is not None
    rows, cols = contact.shape
    cell_mm = max(_GEL_STEP_MM, sensor.pixel_mm)
    size = tuple(max(2, round(n * sensor.pixel_mm / cell_mm)) for n in (cols, rows))
    share = np.asarray(cv2.resize(contact.astype(np.float32), size, interpolation=cv2.INTER_AREA))
    pressed = np.asarray(
        cv2.resize(
            np.where(contact, indentation_mm, 0.0).astype(np.float32),
            size,
            interpolation=cv2.INTER_AREA,
        )
    )
    overlap = np.where(share > _COVERED_SHARE, pressed / np.maximum(share, _COVERED_SHARE), -np.inf)
    beyond = sensor.gel.thickness_mm / cell_mm  # width of the pad beyond the view, as simulated
    continued = round(0.5 * beyond)
    margin = math.ceil(beyond)
    overlap = np.pad(overlap, continued, mode="edge")
    overlap = np.pad(overlap, margin - continued, constant_values=-np.inf)
    found = gel.press_gel(sensor.gel, cell_mm, overlap, tolerance_mm=_TOLERANCE_MM)
    return PressedCells(
        pressure_kpa=found.pressure_kpa, force_n=found.force_n, cell_mm=cell_mm, margin_cells=margin
    )


def estimate_bubble_force(
    sensor: SensorSpec, _frame: TactileFrame, indentation_mm: Floats, contact: Mask
) -> ContactForce:
    """Normal force of a contact (rows, cols) with the described bubble.

    `indentation_mm` is finite in contact.

    The shape is that of the described membrane at rest less the indentation.
    """
    assert sensor.bubble is not None
    on = bubble.make_lattice(sensor.bubble, _BUBBLE_STEP_MM)
    surface_mm = np.where(contact, sensor.rest_depth_mm - indentation_mm, np.nan)
    ceiling_mm = bubble.compute_ceiling_from_depth(sensor, surface_mm, on)
    pressed = bubble.press_bubble(sensor.bubble, ceiling_mm, on, tolerance_mm=10 * _TOLERANCE_MM)
    return ContactForce(normal_n=pressed.force_n)
