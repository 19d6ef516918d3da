"""Force of the touch behind a depth map, by the contact model of its sensor's kind: normal by the
contact's shape, and on a gel shear by the printed markers.

Not a column: a quantity of the stage *depth*, computed where a report, a table or the timeline asks
for it.
"""

import math
from collections.abc import Callable

import numpy as np

from pipeline.calibration.markers import track_markers
from pipeline.core.arrays import Doubles, Floats, Mask
from pipeline.core.errors import SettingProblem, find_uncertain_contact
from pipeline.core.graph import Method, skip_if_exact
from pipeline.core.params import NoParams
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.physics.contact_force import (
    ContactForce,
    estimate_bubble_force,
    press_gel_contact,
)
from pipeline.physics.optics import compute_marker_motion_px
from pipeline.physics.shear_force import MarkerMotion, estimate_shear_force
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable
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


# (sensor, frame, indentation_mm, contact) -> force
EstimateForce = Callable[[SensorSpec, TactileFrame, Floats, Mask], ContactForce]
FORCE_MODELS: KindTable[EstimateForce] = KindTable(
    {GelSensor: estimate_gel_force, BubbleSensor: estimate_bubble_force}
)


def skip_without_contact(
    depth: DepthMap, source: SensorSpec, _frame: TactileFrame, _params: NoParams
) -> ContactForce | None:
    """No force where nothing is in contact, an unknown one where that is uncertain, else None."""
    if depth.contact.any():
        return None
    uncertain = find_uncertain_contact(depth.notes)
    if uncertain is not None:
        return ContactForce(normal_n=math.nan, notes=(uncertain,))
    shear_n = None if source.markers is None else (0.0, 0.0)
    return ContactForce(normal_n=0.0, shear_n=shear_n, notes=("no contact: no force",))


def estimate_force(
    depth: DepthMap,
    source: SensorSpec,
    frame: TactileFrame,
    _params: NoParams,
    _progress: Progress = SILENT,
) -> ContactForce:
    """Force of the contact with the described gel or membrane.

    Raises SettingProblem for another kind.
    """
    estimate = FORCE_MODELS.get(source.sensor_kind)
    if estimate is None:
        raise SettingProblem(
            f"sensors of kind {source.kind!r} such as {source.name} have no contact model for force"
        )
    contact = depth.contact & np.isfinite(depth.indentation_mm)
    return estimate(source.with_camera(depth.camera), frame, depth.indentation_mm, contact)


FORCE = Method(
    stage="force",
    name="contact_model",
    title="Force",
    help="the contact pressed into the described gel or membrane",
    run=skip_if_exact(skip_without_contact, estimate_force),
    params=NoParams,
    reads=("depth", "source", "frame"),
    version=2,
)
