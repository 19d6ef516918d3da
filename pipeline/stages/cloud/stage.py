"""The stage *cloud*: contact points in the target's frame."""

from pipeline.core.graph import Method, skip_if_exact
from pipeline.core.values.results import Cloud
from pipeline.stages.cloud import back_projection
from pipeline.stages.stage import Stage

BACK_PROJECTION = Method(
    stage="cloud",
    name="back_projection",
    title="Back-projection",
    help="every contact pixel as a point (paper, eq. P_T)",
    run=skip_if_exact(back_projection.skip_without_contact, back_projection.back_project_depth),
    params=back_projection.BackProjectionParams,
    reads=("depth", "alignment"),
    version=3,
)


STAGE = Stage(
    name="cloud",
    title="Cloud",
    sensor_role="target",
    methods=(BACK_PROJECTION,),
    value_type=Cloud,
)
