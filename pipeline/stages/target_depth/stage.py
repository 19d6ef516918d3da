"""The stage *target_depth*: the cloud as depth and contact in the target's image."""

from pipeline.core.graph import Method, skip_if_exact
from pipeline.core.values.results import TargetDepth
from pipeline.stages import ground_truth
from pipeline.stages.stage import Stage
from pipeline.stages.target_depth import surface_projection

SURFACE = Method(
    stage="target_depth",
    name="surface",
    title="Surface",
    help="triangles between neighbouring source pixels, rasterised with a z-buffer",
    run=skip_if_exact(surface_projection.skip_without_contact, surface_projection.project_cloud),
    params=surface_projection.SurfaceProjectionParams,
    reads=("cloud", "target"),
    version=4,
)
POINT_SPLAT = Method(
    stage="target_depth",
    name="paper",
    title="Point splat (paper)",
    help="single points, as in the equations (D_T'' and M_T'')",
    run=skip_if_exact(surface_projection.skip_without_contact, surface_projection.project_cloud),
    params=surface_projection.PointSplatParams,
    reads=("cloud", "target"),
)


STAGE = Stage(
    name="target_depth",
    title="Target depth",
    sensor_role="target",
    methods=(SURFACE, POINT_SPLAT),
    value_type=TargetDepth,
    make_ground_truth=ground_truth.build_target_depth,
)
