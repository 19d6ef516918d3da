"""The slot *depth*: how far the source's membrane is pushed in."""

from __future__ import annotations

from pipeline.engine.graph import Method, unless
from pipeline.stages.depth import stage
from pipeline.stages.readings import reading

PHYSICS = Method(
    slot="depth",
    name="physics",
    title="Physics",
    help="colour look-up and integration for a gel, load on the membrane for a bubble",
    run=unless(stage.untouched, stage.depth),
    params=stage.DepthParams,
    reads=("frame", "source", "calibration"),
    version=3,
)


SLOT = reading(name="depth", title="Depth", legend="membrane", place="source", methods=(PHYSICS,))
