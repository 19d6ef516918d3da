"""Feeling: the depth of the generated touch in the target's frame, which the pose is registered to.

A method that knows the membrane behind its picture (physics) hands it on; any touch, a network's too, can be read the
way the target's own recordings are read, which also tells how much of a touch survives its picture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.params import NoParams
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Instead
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import stage as depth
from pipeline.stages.depth.stage import DepthParams
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, Touch

NO_CONTACT = "no contact: the target's membrane is at rest"
NO_MEMBRANE = "the generated touch is a picture without a membrane: it is read as a recording of the target"


def membrane(
    touch: Touch,
    target: SensorSpec,
    params: NoParams,  # noqa: ARG001 - a method's arguments
    progress: Progress = SILENT,
) -> DepthMap | Instead:
    """The membrane that the touch was made with; where its method knows only the picture, that is read."""
    if touch.membrane is None:
        return Instead(answer=reading(touch, target, DepthParams(), progress), why=NO_MEMBRANE)
    return replace(touch.membrane, known=touch.known)


def without_contact(touch: Touch, target: SensorSpec, params: object) -> DepthMap | None:  # noqa: ARG001 - as above
    """The membrane at rest where the touch is known to be none, else None; same inputs as the two methods."""
    if touch.membrane is None or touch.membrane.contact.any():
        return None
    return replace(touch.membrane, known=touch.known, notes=(NO_CONTACT,))


def reading(touch: Touch, target: SensorSpec, params: DepthParams, progress: Progress = SILENT) -> DepthMap:
    """The touch read as a recording of the target, against its untouched picture; raises what the depth stage does."""
    frame = _as_recorded(touch, target)
    felt = depth.untouched(frame, target, None, params) or depth.depth(frame, target, None, params, progress)
    return replace(felt, known=touch.known)


def _as_recorded(touch: Touch, target: SensorSpec) -> TactileFrame:
    reference = optics.untouched(target) if target.kind == "gel" else target.rest_depth_mm.astype(np.float32)
    return TactileFrame(sensor=target.name, image=touch.image, reference=reference, origin="generated touch")
