"""Feeling: the depth of the generated touch in the target's frame, which the pose is registered to.

A method that knows the membrane behind its picture (physics) hands it on; any touch, a network's too, can be read the
way the target's own recordings are read, which also tells how much of a touch survives its picture.
"""

from __future__ import annotations

from dataclasses import replace

from pipeline.base.params import NoParams
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Fallback
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.depth.photometric import DepthParams
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, GeneratedTouch

NO_CONTACT = "no contact: the target's membrane is at rest"
NO_MEMBRANE = "the generated touch is a picture without a membrane: it is read as a recording of the target"


def use_membrane(
    touch: GeneratedTouch,
    target: SensorSpec,
    params: NoParams,  # noqa: ARG001 - a method's arguments
    progress: Progress = SILENT,
) -> DepthMap | Fallback:
    """The membrane that the touch was made with; where its method knows only the picture, that is read."""
    if touch.membrane is None:
        return Fallback(result=estimate_from_image(touch, target, DepthParams(), progress), reason=NO_MEMBRANE)
    return replace(touch.membrane, in_view=touch.in_view)


def skip_without_contact(touch: GeneratedTouch, target: SensorSpec, params: object) -> DepthMap | None:  # noqa: ARG001 - as above
    """The membrane at rest where the touch is known to be none, else None; same inputs as the two methods."""
    if touch.membrane is None or touch.membrane.contact.any():
        return None
    return replace(touch.membrane, in_view=touch.in_view, notes=(NO_CONTACT,))


def estimate_from_image(
    touch: GeneratedTouch, target: SensorSpec, params: DepthParams, progress: Progress = SILENT
) -> DepthMap:
    """The touch read as a recording of the target, against its untouched picture; raises what the depth stage does."""
    frame = _as_recorded(touch, target)
    felt = depth.skip_without_contact(frame, target, None, params) or depth.estimate_depth(
        frame, target, None, params, progress
    )
    return replace(felt, in_view=touch.in_view)


def _as_recorded(touch: GeneratedTouch, target: SensorSpec) -> TactileFrame:
    reference = target.render_reference()
    return TactileFrame(sensor=target.name, image=touch.image, reference=reference, origin="generated touch")
