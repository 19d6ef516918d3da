"""The slot *depth*: how far the source's membrane is pushed in."""

from __future__ import annotations

from pipeline.engine.graph import Method, unless
from pipeline.stages.depth import depth_anything, network, stage
from pipeline.stages.learned import learned
from pipeline.stages.readings import reading

PHYSICS = Method(
    slot="depth",
    name="physics",
    title="Physics",
    help="colour look-up and integration for a gel, load on the membrane for a bubble",
    run=unless(stage.untouched, stage.recorded),
    params=stage.DepthParams,
    reads=("frame", "source", "calibration"),
    version=11,
    draft=stage.draft,
)
NETWORK = Method(
    slot="depth",
    name="network",
    title="Network",
    help="a compact network, learned from simulated presses on other units; a gel's corrects physics",
    run=unless(network.untouched, learned(network.depth, instead=PHYSICS)),
    params=network.NetworkParams,
    reads=(*PHYSICS.reads, "depth_weights"),
    version=2,
    draft=stage.draft,
    weights=network.weights,
)
DEPTH_ANYTHING = Method(
    slot="depth",
    name="depth_anything",
    title="Depth Anything V2",
    help="the paper's network, on weights that you give",
    run=learned(depth_anything.depth, instead=PHYSICS),
    params=depth_anything.DepthAnythingParams,
    reads=(*PHYSICS.reads, "depth_weights"),
    weights=depth_anything.weights,
)


# Both kinds are read better by the network (`benchmarks/bubble_network.py`, `benchmarks/simulated_depth.py`).
SLOT = reading(
    name="depth", title="Depth", legend="membrane", place="source", methods=(NETWORK, PHYSICS, DEPTH_ANYTHING)
)
