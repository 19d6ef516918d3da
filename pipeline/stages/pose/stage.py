"""The stage *pose*: the object's pose in the target's frame."""

from collections.abc import Mapping

from pipeline.core.graph import Method, skip_if_exact
from pipeline.core.values.results import ObjectPose
from pipeline.stages import ground_truth
from pipeline.stages.metrics.stage_metrics import compute_pose_metrics
from pipeline.stages.networks.network_factory import fall_back_without_weights
from pipeline.stages.pose import network, signed_distances
from pipeline.stages.stage import GroundTruth, Stage

SIGNED_DISTANCES = Method(
    stage="pose",
    name="signed_distances",
    title="Mesh fit",
    help="many starts, registered on the mesh's signed distances, scored by contact and free space",
    run=skip_if_exact(
        signed_distances.skip_without_contact, signed_distances.estimate_or_track_pose
    ),
    params=signed_distances.PoseParams,
    reads=("touch_depth", "mesh", "previous"),
    version=8,
)
PAPER_2D = Method(
    stage="pose",
    name="paper_2d",
    title="Planar (paper)",
    help="the paper's released evaluation: in-plane rotation and translation of projections",
    run=skip_if_exact(signed_distances.skip_without_contact, signed_distances.estimate_pose_planar),
    params=signed_distances.PoseParams,
    reads=("touch_depth", "mesh"),
)
ICP = Method(
    stage="pose",
    name="icp",
    title="ICP (Open3D)",
    help="point-to-plane ICP on sampled points, as in the paper",
    run=skip_if_exact(signed_distances.skip_without_contact, signed_distances.estimate_pose_icp),
    params=signed_distances.PoseParams,
    reads=("touch_depth", "mesh"),
)
NETWORK = Method(
    stage="pose",
    name="network",
    title="Network",
    help="the paper's tactile metric: planar pose of trained objects, from the tactile image",
    run=fall_back_without_weights(
        network.predict_pose,
        network.REGISTRATION_OF_TOUCH,
        "mesh fit: no network for this target",
    ),
    params=signed_distances.PoseParams,
    reads=(*network.READS, "pose_weights"),
    weights=network.select_weights,
)


def _compute_metrics(pose: ObjectPose, facts: GroundTruth) -> Mapping[str, float]:
    return (
        {}
        if facts.target_truth is None
        else compute_pose_metrics(pose, facts.target_truth, facts.mesh, facts.symmetry)
    )


STAGE = Stage(
    name="pose",
    title="Object pose",
    sensor_role="target",
    methods=(SIGNED_DISTANCES, PAPER_2D, ICP, NETWORK),
    value_type=ObjectPose,
    compute_metrics=_compute_metrics,
    make_ground_truth=ground_truth.build_pose,
    has_steps=True,
)
