"""The stage *touch_depth*: depth of the generated touch in the target's frame."""

from pipeline.base.params import NoParams
from pipeline.engine.graph import Method, skip_if_exact
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.depth.photometric import make_draft_params as depth_draft
from pipeline.stages.depth_map_stage import make_depth_stage
from pipeline.stages.touch_depth import membrane

MEMBRANE = Method(
    stage="touch_depth",
    name="membrane",
    title="Membrane",
    help="the membrane computed with the generated touch",
    run=skip_if_exact(membrane.skip_without_contact, membrane.use_membrane),
    params=NoParams,
    reads=("touch", "target"),
)
FROM_IMAGE = Method(
    stage="touch_depth",
    name="from_image",
    title="From the image",
    help="the target's depth method on the generated image",
    run=skip_if_exact(membrane.skip_without_contact, membrane.estimate_from_image),
    params=DepthParams,
    reads=("touch", "target"),
    draft=depth_draft,
)


STAGE = make_depth_stage(
    name="touch_depth",
    title="Touch depth",
    legend="depth of the generated touch",
    sensor_role="target",
    methods=(MEMBRANE, FROM_IMAGE),
)
