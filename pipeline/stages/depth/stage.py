"""The stage *depth*: indentation, depth and contact of the source sensor."""

from pipeline.core.graph import Method, skip_if_exact
from pipeline.core.params import NoParams
from pipeline.stages.depth import bubble_network, depth_anything, photometric, unet
from pipeline.stages.depth.gel.chain import NODES, READS
from pipeline.stages.ground_truth import make_depth_stage
from pipeline.stages.networks.network_factory import fall_back_without_weights

_NO_NETWORK = "physics: no network for this sensor"
PHYSICS = Method(
    stage="depth",
    name="physics",
    title="Physics",
    help="photometric stereo and integration for a gel, load on the membrane for a bubble",
    run=photometric.run_physics,
    params=photometric.DepthParams,
    reads=READS,
    nodes=NODES,
    version=21,
)
NETWORK = Method(
    stage="depth",
    name="network",
    title="Network",
    help="a compact network of a bubble's membrane and contact, trained on simulated touches",
    kinds=bubble_network.KINDS,
    run=skip_if_exact(
        bubble_network.skip_without_contact,
        fall_back_without_weights(bubble_network.estimate_frame, PHYSICS, _NO_NETWORK),
    ),
    params=bubble_network.NetworkParams,
    reads=(*PHYSICS.reads, "depth_weights"),
    version=11,
    weights=bubble_network.select_weights,
)
DEPTH_ANYTHING = Method(
    stage="depth",
    name="depth_anything",
    title="Depth Anything V2",
    help="the paper's network, with weights that you give",
    run=fall_back_without_weights(depth_anything.estimate_depth, PHYSICS, _NO_NETWORK),
    params=depth_anything.DepthAnythingParams,
    version=2,
    reads=(*PHYSICS.reads, "depth_weights"),
    weights=depth_anything.select_weights,
)
UNET = Method(
    stage="depth",
    name="unet",
    title="U-Net",
    help="the lab's networks, with weights that you give: depth of a gel (gelslim_depth) or "
    "contact of a bubble",
    run=fall_back_without_weights(unet.estimate_depth, fallback=PHYSICS),
    params=NoParams,
    reads=(*PHYSICS.reads, "depth_weights"),
    weights=unet.select_weights,
)

# The first that fits the sensor is the default: a bubble's network errs less
# (`benchmarks/bubble_network.py`).
STAGE = make_depth_stage(
    name="depth",
    title="Depth",
    sensor_role="source",
    methods=(NETWORK, PHYSICS, DEPTH_ANYTHING, UNET),
)
