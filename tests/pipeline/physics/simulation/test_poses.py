import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.core.arrays import freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.physics import lattice
from pipeline.physics.lattice import Lattice
from pipeline.physics.simulation import poses, shapes
from pipeline.physics.simulation.poses import HALF_WINDOW_MM, compute_lowest_mm
from pipeline.sensors.spec import load_sensor

ROUND_MM = 1e-9
STEP_MM = 0.02
SLOPE_MM = 0.05  # what one step of the checking grid hides on a side as steep as 60 degrees
SHAPES = ("square", "sphere", "ring", "spanner", "pencil")
WINDOW = Lattice(x0_mm=-HALF_WINDOW_MM, y0_mm=-HALF_WINDOW_MM, step_mm=STEP_MM, shape=(601, 601))


def mesh_of(name):
    return shapes.make_shape(name).mesh


def turned_by(pose):
    """(turn in the plane, tilt out of it) in degrees."""
    return np.rad2deg(np.arctan2(pose[1, 0], pose[0, 0])), np.rad2deg(
        np.arccos(min(1.0, pose[2, 2]))
    )


def depth_mm(mesh, pose):
    return -compute_lowest_mm(rigid.apply(pose, mesh.vertices_mm), mesh.triangles)


@given(seed=st.integers(0, 2**31 - 1), name=st.sampled_from(SHAPES))
@settings(max_examples=8)
def test_a_grid_covers_the_square_and_keeps_its_bounds(seed, name):
    mesh = mesh_of(name)
    grid = poses.make_paper_grid(mesh, seed=seed)
    assert len(grid) == 60
    places = np.array([p[:2, 3] for p in grid]) / poses.SPREAD_MM + 0.5
    assert ((places >= 0) & (places < 1)).all()
    cells = (places * 5).astype(int)
    assert len(np.unique(cells, axis=0)) == 25  # nowhere a hole of 2 mm
    for pose in grid:
        assert np.abs(pose - rigid.validate_rigid(pose, "a pose")).max() < ROUND_MM
        angle, tilt = turned_by(pose)
        # a tilt of 3 degrees turns the x axis' shadow by up to 0.04
        assert abs(angle) <= poses.MAX_ANGLE_DEG + 0.1
        assert tilt <= poses.MAX_TILT_DEG + ROUND_MM
        assert (
            poses.DEPTH_RANGE_MM[0] - ROUND_MM
            <= depth_mm(mesh, pose)
            <= poses.DEPTH_RANGE_MM[1] + ROUND_MM
        )
        assert not pose.flags.writeable


def test_a_grid_spreads_angles_tilts_and_depths_over_their_ranges():
    mesh = mesh_of("hexagon")
    grid = poses.make_paper_grid(mesh, n=40, seed=5)
    angle, tilt = np.array([turned_by(p) for p in grid]).T
    depth = np.array([depth_mm(mesh, p) for p in grid])
    low, high = poses.DEPTH_RANGE_MM
    for share in (
        (angle / poses.MAX_ANGLE_DEG + 1) / 2,
        (tilt / poses.MAX_TILT_DEG) ** 2,
        (depth - low) / (high - low),
    ):
        assert (np.abs(np.sort(share) - (np.arange(40) + 0.5) / 40) < 0.75 / 40).all()
    assert np.abs(np.corrcoef([angle, tilt, depth])[np.triu_indices(3, 1)]).max() < 0.5


def test_the_same_seed_gives_the_same_bytes_and_another_does_not():
    def grid(seed):
        return np.array(poses.make_paper_grid(mesh_of("edge"), n=7, seed=seed)).tobytes()

    def motion(seed):
        return np.array(poses.make_motion(mesh_of("edge"), "full", n=7, seed=seed)).tobytes()

    assert grid(3) == grid(3) != grid(4)
    assert motion(3) == motion(3) != motion(4)


@given(
    name=st.sampled_from(SHAPES),
    x=st.floats(-9, 9),
    y=st.floats(-9, 9),
    turn=st.floats(-180, 180),
    lean=st.floats(0, 8),
)
@example(name="sphere", x=0.0, y=0.0, turn=0.0, lean=1.1e-308)
@settings(max_examples=15)
def test_the_deepest_point_is_that_of_a_fine_grid_over_the_gels(name, x, y, turn, lean):
    mesh = mesh_of(name)
    pose = rigid.from_parts((x, y, 0.0), (lean, 0.0, 0.0)) @ rigid.from_parts(
        (0, 0, 0), (0.0, 0.0, turn)
    )
    vertices = rigid.apply(pose, mesh.vertices_mm)
    seen = lattice.rasterise_mesh(vertices, mesh.triangles, WINDOW).min()
    if np.isfinite(seen):
        assert -SLOPE_MM < compute_lowest_mm(vertices, mesh.triangles) - seen < 1e-6


def test_the_deepest_point_of_a_tilted_plane_is_at_a_corner_of_the_square():
    corners = np.array(
        [[-50.0, -50.0, 0.0], [50.0, -50.0, 0.0], [50.0, 50.0, 0.0], [-50.0, 50.0, 0.0]]
    )
    corners[:, 2] = 0.1 * corners[:, 0] + 0.02 * corners[:, 1]
    plane = Mesh(
        vertices_mm=freeze(corners), triangles=freeze(np.array([[0, 2, 1], [0, 3, 2]], np.int32))
    )
    assert compute_lowest_mm(plane.vertices_mm, plane.triangles) == pytest.approx(
        -0.12 * HALF_WINDOW_MM
    )
    outside = corners + np.array([200.0, 0.0, 0.0])
    assert compute_lowest_mm(outside, plane.triangles) == pytest.approx(-6.0)


def test_every_gel_sees_the_square_that_depths_are_measured_over():
    for name in ("gelslim", "digit", "gelsight_mini"):
        spec = load_sensor(name)
        assert min(spec.camera.shape) * spec.pixel_mm >= 2 * HALF_WINDOW_MM


@pytest.mark.parametrize("kind", [*poses.MOTION_PHASES, "full"])
@given(seed=st.integers(0, 2**31 - 1))
@settings(max_examples=5)
def test_a_motion_is_smooth(kind, seed):
    mesh = mesh_of("letters")
    n = 33
    motion = poses.make_motion(mesh, kind, n=n, seed=seed)
    assert len(motion) == n
    depth = np.array([depth_mm(mesh, p) for p in motion])
    assert poses.DEPTH_RANGE_MM[0] - ROUND_MM <= depth.max() <= poses.DEPTH_RANGE_MM[1] + ROUND_MM
    phases = 4 if kind == "full" else 1
    steps = np.array([p[:2, 3] for p in motion])
    fastest = 1.875 * phases / (n - 1)  # of a least-jerk motion, in shares a frame
    assert (
        np.linalg.norm(np.diff(steps, axis=0), axis=1).max()
        <= fastest * poses.SLIDE_RANGE_MM[1] + ROUND_MM
    )
    assert (
        np.abs(np.diff(depth)).max()
        <= fastest * (poses.CLEARANCE_MM + poses.DEPTH_RANGE_MM[1]) + ROUND_MM
    )


def test_each_motion_does_what_its_name_says():
    mesh = mesh_of("letters")
    motion = {k: poses.make_motion(mesh, k, n=21, seed=9) for k in (*poses.MOTION_PHASES, "full")}
    depth = {k: np.array([depth_mm(mesh, p) for p in m]) for k, m in motion.items()}
    way = {k: np.linalg.norm(m[-1][:2, 3] - m[0][:2, 3]) for k, m in motion.items()}
    turn = {k: abs(turned_by(m[-1])[0] - turned_by(m[0])[0]) for k, m in motion.items()}
    assert depth["press"][0] == pytest.approx(-poses.CLEARANCE_MM)
    assert (np.diff(depth["press"]) > -ROUND_MM).all()
    assert np.allclose(depth["release"], depth["press"][::-1])
    assert np.ptp(depth["slide"]) < ROUND_MM
    assert np.ptp(depth["twist"]) < ROUND_MM
    low, high = poses.SLIDE_RANGE_MM
    assert low <= way["slide"] <= high
    assert way["press"] == way["twist"] == way["release"] == 0.0
    assert poses.TWIST_RANGE_DEG[0] - 0.1 <= turn["twist"] <= poses.TWIST_RANGE_DEG[1] + 0.1
    assert max(turn["press"], turn["slide"], turn["release"]) < 1e-9
    assert depth["full"][[0, -1]] == pytest.approx(-poses.CLEARANCE_MM)
    slid = np.linalg.norm(np.diff([p[:2, 3] for p in motion["full"]], axis=0), axis=1) > 1e-6
    twisted = np.abs(np.diff([turned_by(p)[0] for p in motion["full"]])) > 1e-6
    assert np.flatnonzero(slid).tolist() == [5, 6, 7, 8, 9]
    assert np.flatnonzero(twisted).tolist() == [10, 11, 12, 13, 14]
