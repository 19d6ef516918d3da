from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.errors import MeshProblem
from pipeline.core.geometry import distance_grid, rigid
from pipeline.core.geometry.distance_grid import OPEN_MESH_NOTE, build_grid, load_distance_grid
from pipeline.core.geometry.meshes import Mesh, sample_surface
from pipeline.core.progress import Cancelled
from pipeline.physics.simulation.shapes import solids
from tests.pipeline.stages.pose.registration.solids import ball

QUANTUM_MM = 2e-4  # float32 distances and 16-bit steps
EDGE_SHARE = 0.75  # of a fine step: the most that a straight line between nodes misses at an edge


@pytest.fixture(scope="module")
def block():
    return solids.make_chamfered_prism([(0, 0), (8, 0), (8, 5), (0, 5)], 4.0, 0.5, "block")


@pytest.fixture(scope="module")
def grid(block):
    return build_grid(block)


def joined(a, b):
    return Mesh(
        vertices_mm=np.concatenate([a.vertices_mm, b.vertices_mm]),
        triangles=np.concatenate([a.triangles, b.triangles + len(a.vertices_mm)]).astype(np.int32),
    )


def same(a, b):
    return all(
        np.array_equal(getattr(a, n), getattr(b, n))
        for n in ("origin_mm", "coarse_mm", "block", "fine")
    )


def test_above_a_face_distance_and_direction_are_exact(grid):
    rng = np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(2, 6, 500), rng.uniform(2, 3, 500), 4.0 + rng.uniform(-0.9, 2.5, 500)]
    )
    distance, slope = grid.at(points)
    np.testing.assert_allclose(distance, points[:, 2] - 4.0, atol=QUANTUM_MM)
    np.testing.assert_allclose(slope, np.tile([0.0, 0.0, 1.0], (500, 1)), atol=5e-3)


def test_the_surface_lies_at_zero_up_to_the_fine_step_at_edges(block, grid):
    distance, _ = grid.at(sample_surface(block, 5000, 0)[0])
    assert np.abs(distance).max() < EDGE_SHARE * grid.step_mm / 8
    assert np.median(np.abs(distance)) < QUANTUM_MM


def test_a_ball_of_fine_triangles_has_its_distances_and_a_bounded_size():
    grid = build_grid(ball(6.0))
    rng = np.random.default_rng(1)
    way = rng.standard_normal((2000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    far = rng.uniform(-0.3, 2.0, 2000)
    distance, slope = grid.at((6.0 + far)[:, None] * way)
    assert np.abs(distance - far).max() < 0.03, (
        "sagitta of the ball's triangles and of the coarse lattice"
    )
    assert np.einsum("ij,ij->i", slope, way).min() > 0.9, (
        "between coarse nodes, 0.8 mm apart, directions turn"
    )
    assert sum(a.nbytes for a in (grid.coarse_mm, grid.block, grid.fine)) < 16e6


def test_overlapping_bodies_are_their_union_and_far_points_are_told_the_way_back(block):
    other = solids.transform_mesh(block, rigid.translation(4.0, 1.0, 1.0))
    grid = build_grid(joined(block, other))
    inside_both, inside_one, outside = grid.at(
        np.array([[6.0, 3.0, 2.5], [2.0, 2.5, 2.0], [2.0, 5.6, 2.0]])
    )[0]
    assert inside_both < 0
    assert inside_one < 0
    assert outside == pytest.approx(0.6, abs=0.01)
    distance, slope = grid.at(np.array([[1e6, 2.5, 2.0]]))
    assert distance[0] == pytest.approx(1e6, rel=1e-4)
    np.testing.assert_allclose(slope[0], [1.0, 0.0, 0.0], atol=1e-3)


def test_a_body_turned_inside_out_has_the_same_inside(block, grid):
    inverted = Mesh(vertices_mm=block.vertices_mm, triangles=block.triangles[:, ::-1].copy())
    found = build_grid(inverted)
    np.testing.assert_allclose(found.coarse_mm, grid.coarse_mm, atol=QUANTUM_MM)
    assert np.abs(found.fine.astype(int) - grid.fine).max() <= 1, (
        "its triangles are measured from another corner"
    )


def test_an_open_sheet_is_told_apart_by_its_sides_and_says_so(block):
    normals = np.cross(
        *(
            block.vertices_mm[block.triangles[:, k]] - block.vertices_mm[block.triangles[:, 0]]
            for k in (1, 2)
        )
    )
    lidless = Mesh(vertices_mm=block.vertices_mm, triangles=block.triangles[normals[:, 2] < 0.5])
    grid = build_grid(lidless)
    assert grid.notes == (OPEN_MESH_NOTE,)
    np.testing.assert_allclose(
        grid.at(np.array([[4.0, 2.5, -0.4], [4.0, 2.5, 0.4]]))[0], [0.4, -0.4], atol=QUANTUM_MM
    )


def test_what_is_not_finite_has_no_distance(grid):
    distance, slope = grid.at(np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]]))
    assert np.isnan(distance).all()
    assert np.isnan(slope).all()


def test_a_mesh_without_surface_is_refused():
    with pytest.raises(MeshProblem, match="zero area"):
        build_grid(Mesh(vertices_mm=np.zeros((3, 3)), triangles=np.zeros((1, 3), np.int32)))
    with pytest.raises(MeshProblem, match="no triangles"):
        build_grid(Mesh(vertices_mm=np.zeros((0, 3)), triangles=np.zeros((0, 3), np.int32)))


def test_building_can_be_cancelled(block):
    class Impatient:
        def step(self, fraction, text):
            raise Cancelled

    with pytest.raises(Cancelled):
        build_grid(block, Impatient())


def test_a_kept_grid_equals_a_fresh_one_and_is_not_built_again(block, grid, tmp_path, monkeypatch):
    assert same(load_distance_grid(block, folder=tmp_path), grid)
    assert [p.suffix for p in tmp_path.iterdir()] == [".npz"]
    monkeypatch.setattr(distance_grid, "build_grid", lambda *_: pytest.fail("it was kept"))
    assert same(load_distance_grid(block, folder=tmp_path), grid)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 half a file", "flipped", "cut"])
def test_a_damaged_file_is_made_again(block, grid, tmp_path, damage):
    load_distance_grid(block, folder=tmp_path)
    path = next(tmp_path.iterdir())
    whole = path.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
    path.write_bytes({"flipped": flipped, "cut": whole[:middle]}.get(damage, damage))
    assert same(load_distance_grid(block, folder=tmp_path), grid)
    assert path.read_bytes() == whole


def test_a_folder_that_cannot_be_written_is_done_without(block, grid, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert same(load_distance_grid(block, folder=blocked / "grids"), grid)


@pytest.mark.parametrize(
    "turn_rad", [(0.0, 0.0, 0.0), (0.4, -0.7, 1.1)], ids=["along the lattice", "askew"]
)
def test_distances_far_and_near_are_those_to_the_nearest_of_many_points(block, turn_rad):
    from scipy.spatial import KDTree

    turned = solids.transform_mesh(block, rigid.rotation(turn_rad))
    grid = build_grid(turned)
    nodes = np.stack(
        np.meshgrid(*(np.arange(n) for n in grid.coarse_mm.shape), indexing="ij"), axis=-1
    )
    places = grid.origin_mm + grid.step_mm * nodes.reshape(-1, 3)
    to_points = KDTree(sample_surface(turned, 100_000, 0)[0]).query(places)[0]
    above_mm = to_points - np.abs(grid.coarse_mm.ravel())
    assert above_mm.min() > -QUANTUM_MM, "no point of the surface is nearer"
    assert above_mm.max() < 0.15, "100,000 points on 200 mm2 leave gaps of that size"
