"""The stage *touch_depth*: depth of the generated touch in the target's frame.

The pose is registered to it.

A method that computes the membrane (physics) passes it on. Any generated image can also go through
the target's depth method, which shows how much of a touch the image preserves.
"""

from dataclasses import replace

from pipeline.core.errors import describe_no_contact
from pipeline.core.graph import Fallback, Method, skip_if_exact
from pipeline.core.params import NoParams
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.ground_truth import make_depth_stage

_AT_REST = "the target's membrane is at rest"
NO_MEMBRANE = "depth from the image: the generated touch has no membrane"


def use_membrane(
    touch: GeneratedTouch,
    target: SensorSpec,
    params: NoParams,  # noqa: ARG001 - a method's arguments
    progress: Progress = SILENT,
) -> DepthMap | Fallback:
    """The membrane of the generated touch; estimated from its image where there is none."""
    if touch.membrane is None:
        return Fallback(
            result=estimate_from_image(touch, target, DepthParams(), progress), reason=NO_MEMBRANE
        )
    return replace(touch.membrane, in_view=touch.in_view)


def skip_without_contact(touch: GeneratedTouch, *_: object) -> DepthMap | None:
    """The membrane at rest if the touch has no contact, else None, whatever else a method reads."""
    if touch.membrane is None or touch.membrane.contact.any():
        return None
    return replace(
        touch.membrane, in_view=touch.in_view, notes=(describe_no_contact(_AT_REST, touch.notes),)
    )


def estimate_from_image(
    touch: GeneratedTouch, target: SensorSpec, params: DepthParams, progress: Progress = SILENT
) -> DepthMap:
    """Depth of the generated image by the target's depth method and reference image.

    Raises as the depth stage does.
    """
    frame = _make_frame(touch, target)
    touch_depth = depth.estimate_depth(frame, target, None, params, progress)
    return replace(touch_depth, in_view=touch.in_view)


def _make_frame(touch: GeneratedTouch, target: SensorSpec) -> TactileFrame:
    reference = render_reference(target)
    return TactileFrame(
        sensor=target.name, image=touch.image, reference=reference, origin="generated touch"
    )


MEMBRANE = Method(
    stage="touch_depth",
    name="membrane",
    title="Generated membrane",
    help="the membrane computed with the generated touch",
    run=skip_if_exact(skip_without_contact, use_membrane),
    params=NoParams,
    reads=("touch", "target"),
)
FROM_IMAGE = Method(
    stage="touch_depth",
    name="from_image",
    title="From the image",
    help="the target's depth method on the generated image",
    run=skip_if_exact(skip_without_contact, estimate_from_image),
    params=DepthParams,
    reads=("touch", "target"),
)


STAGE = make_depth_stage(
    name="touch_depth",
    title="Touch depth",
    sensor_role="target",
    methods=(MEMBRANE, FROM_IMAGE),
)
