"""The slot *felt*: the depth of the generated touch, in the target's frame."""

from __future__ import annotations

from pipeline.base.params import NoParams
from pipeline.engine.graph import Method, unless
from pipeline.stages.depth.stage import DepthParams
from pipeline.stages.depth.stage import draft as depth_draft
from pipeline.stages.feel import stage
from pipeline.stages.readings import reading

MEMBRANE = Method(
    slot="felt",
    name="membrane",
    title="Its membrane",
    help="the membrane that the touch was made with",
    run=unless(stage.without_contact, stage.membrane),
    params=NoParams,
    reads=("touch", "target"),
)
READING = Method(
    slot="felt",
    name="reading",
    title="Read as recorded",
    help="the picture goes through the target's own depth method",
    run=unless(stage.without_contact, stage.reading),
    params=DepthParams,
    reads=("touch", "target"),
    draft=depth_draft,
)


SLOT = reading(name="felt", title="Felt", legend="as the target feels it", place="target", methods=(MEMBRANE, READING))
