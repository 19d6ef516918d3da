"""Force of the touch behind a depth map, by the contact model of its sensor's kind.

Not a column: a quantity of the stage *depth*, computed where a report, a table or the timeline asks
for it.
"""

import math
from collections.abc import Callable

import numpy as np

from pipeline.core.arrays import Floats, Mask
from pipeline.core.errors import SettingProblem, find_uncertain_contact
from pipeline.core.graph import Method, skip_if_exact
from pipeline.core.params import NoParams
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.physics.contact_force import ContactForce, estimate_bubble_force
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel_force import estimate_gel_force

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
