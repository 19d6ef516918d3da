"""Force of a touch on a gel: normal by the contact's shape, shear by the printed markers."""

import numpy as np

from pipeline.calibration.markers import track_markers
from pipeline.core.arrays import Doubles, Floats, Mask
from pipeline.core.values.frames import TactileFrame
from pipeline.physics.contact_force import ContactForce, press_gel_contact
from pipeline.physics.optics import compute_marker_motion_px
from pipeline.physics.shear_force import MarkerMotion, estimate_shear_force
from pipeline.sensors.spec import SensorSpec


def estimate_gel_force(
    sensor: SensorSpec, frame: TactileFrame, indentation_mm: Floats, contact: Mask
) -> ContactForce:
    """Force of a contact (rows, cols) with the described gel.

    `indentation_mm` is finite in contact.

    Shear is measured where the sensor has markers and the frame a reference.
    """
    assert sensor.gel is not None
    pressed = press_gel_contact(sensor, indentation_mm, contact)
    if sensor.markers is None or frame.reference is None:
        return ContactForce(normal_n=pressed.force_n)
    # the depth may have fewer pixels
    pixel_mm = sensor.pixel_mm * contact.shape[1] / frame.image.shape[1]
    start, end = track_markers(frame.reference, frame.image, sensor.markers, pixel_mm)
    places_mm = (end + 0.5) * pixel_mm
    moved_mm = (end - start) * pixel_mm - _compute_pressed_motion(sensor, indentation_mm, places_mm)
    motion = MarkerMotion(places_mm=places_mm, motion_mm=moved_mm)
    return ContactForce(
        normal_n=pressed.force_n, shear_n=estimate_shear_force(sensor.gel, pressed, motion)
    )


def _compute_pressed_motion(
    sensor: SensorSpec, indentation_mm: Floats, places_mm: Doubles
) -> Doubles:
    """Motion (n, 2) in mm of markers by pressing alone."""
    from scipy.ndimage import map_coordinates

    motion_px = compute_marker_motion_px(sensor, np.nan_to_num(indentation_mm, nan=0.0))
    at = (places_mm / sensor.pixel_mm - 0.5)[:, ::-1].T
    return sensor.pixel_mm * np.stack(
        [map_coordinates(a, at, order=1, mode="nearest") for a in motion_px], axis=1
    )
