import numpy as np
import pytest

from pipeline.core.errors import FileProblem, MeshProblem, SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import sample_surface
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.shapes import make_shape as made_once
from pipeline.physics.simulation.shapes import polygons

CHORD_MM = 0.002  # what the shapes promise
# twice the chord error, once for each of the two surfaces, and a little for a ball's back
SYMMETRIC_MM = 0.005
DIFFERENT_MM = 0.1  # resolved by every sensor
NEAR_MM = 0.15  # farther is far
SMALLEST_TRIANGLE_SQ_MM = 1e-5  # 4 um wide: far above rounding
CURVED = (
    "lines_45",
    "cylinder",
    "sphere",
    "ring",
    "curve",
    "ellipse",
    "cone",
    "wave",
    "hex_key",
    "cup_rim",
    "marble",
)


def surface_distance_mm(mesh, points):
    """Exact below `NEAR_MM`, infinite beyond.

    Ray casters work in float32 and lose micrometres on slivers.
    """
    corners = mesh.vertices_mm[mesh.triangles]
    low = corners.min(axis=1).T - NEAR_MM
    high = corners.max(axis=1).T + NEAR_MM
    distance = np.full(len(points), np.inf)
    for k, point in enumerate(points):
        near = np.flatnonzero((low[0] < point[0]) & (point[0] < high[0]))
        for axis in (1, 2):
            near = near[(low[axis, near] < point[axis]) & (point[axis] < high[axis, near])]
        if len(near):
            distance[k] = triangle_distance_mm(corners[near], point).min()
    return np.where(distance < NEAR_MM, distance, np.inf)


def triangle_distance_mm(corners, point):
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    over = np.ones(len(corners), dtype=bool)
    outside = np.full(len(corners), np.inf)
    for k in range(3):
        to = point - corners[:, k]
        edge = corners[:, (k + 1) % 3] - corners[:, k]
        over &= (np.cross(normal, edge) * to).sum(axis=1) >= 0
        share = np.clip((to * edge).sum(axis=1) / (edge**2).sum(axis=1), 0.0, 1.0)
        outside = np.minimum(outside, np.linalg.norm(to - share[:, None] * edge, axis=1))
    return np.where(over, np.abs((normal * (point - corners[:, 0])).sum(axis=1)), outside)


def edges_of(mesh):
    t = mesh.triangles.astype(np.int64)
    return np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])


def areas_sq_mm(mesh):
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


@pytest.mark.parametrize("name", shapes.list_shapes())
def test_every_shape_is_one_closed_body_that_faces_outward(name):
    mesh = shapes.make_shape(name).mesh
    edges = edges_of(mesh)
    there = edges[:, 0] * len(mesh.vertices_mm) + edges[:, 1]
    back = edges[:, 1] * len(mesh.vertices_mm) + edges[:, 0]
    assert len(np.unique(there)) == len(there)
    assert np.array_equal(np.sort(there), np.sort(back))
    corners = mesh.vertices_mm[mesh.triangles]
    volume = (
        np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    )
    assert 50.0 < volume < 25_000.0  # tools of up to 6 cm: neither metres nor inches were meant
    assert areas_sq_mm(mesh).min() > SMALLEST_TRIANGLE_SQ_MM
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.vertices_mm)))


@pytest.mark.parametrize("name", shapes.list_shapes())
def test_every_shape_has_the_size_of_a_fingertip_and_covers_its_origin(name):
    found = shapes.make_shape(name)
    low = found.mesh.vertices_mm.min(axis=0)
    high = found.mesh.vertices_mm.max(axis=0)
    assert 6.0 <= (high - low).max() <= 60.1  # the lab's
    assert (low[:2] < 0).all()
    assert (high[:2] > 0).all()
    assert len(found.mesh.triangles) <= 15_000
    assert found.mesh.name == name
    assert not found.mesh.vertices_mm.flags.writeable


def test_the_groups_are_twelve_six_and_six_without_overlap():
    assert [len(shapes.list_shapes(g)) for g in shapes.GROUPS] == [12, 6, 6, 1]
    assert len(set(shapes.list_shapes())) == 25


def test_unknown_names_are_refused_with_a_list_of_names():
    with pytest.raises(SettingProblem, match=r"'squre'.*square"):
        shapes.make_shape("squre")
    with pytest.raises(SettingProblem, match="unseen"):
        shapes.list_shapes("hidden")


@pytest.mark.parametrize("name", CURVED)
def test_curved_faces_are_within_two_micrometres_of_much_finer_ones(name, monkeypatch):
    mesh = shapes.make_shape(name).mesh
    monkeypatch.setattr(polygons, "CHORD_MM", polygons.CHORD_MM / 9.0)
    fine = made_once.__wrapped__(name).mesh
    assert len(fine.triangles) > 2 * len(mesh.triangles)
    points, _normals = sample_surface(mesh, 2500, seed=0)
    tactile = points[points[:, 2] < mesh.vertices_mm[:, 2].min() + 2.0]
    assert len(tactile) > 100
    assert surface_distance_mm(fine, tactile).max() < CHORD_MM


@pytest.mark.parametrize("name", shapes.list_shapes())
def test_symmetries_map_the_surface_onto_itself_and_are_a_group(name):
    found = shapes.make_shape(name)
    points, _normals = sample_surface(found.mesh, 150, seed=1)
    turns = found.symmetry.sample_rotations(0.3)
    assert np.allclose(turns[0], np.eye(3))
    for turn in turns:
        assert np.linalg.det(turn) == pytest.approx(1.0)
        assert np.abs(turns - turn.T).max(axis=(1, 2)).min() < 1e-9  # the way back is one of them
        assert surface_distance_mm(found.mesh, points @ turn.T).max() < SYMMETRIC_MM


@pytest.mark.parametrize("name", shapes.list_shapes())
def test_no_shape_has_more_symmetry_than_declared(name):
    found = shapes.make_shape(name)
    points, _normals = sample_surface(found.mesh, 300, seed=1)
    known = found.symmetry.sample_rotations(1 / 60)  # turns about an axis at most 2 / 60 rad apart
    for axis in np.eye(3):
        for part in (2, 3, 4, 5, 6):
            turn = rigid.rotation(2.0 * np.pi / part * axis)[:3, :3]
            cosine = 0.5 * (np.einsum("nij,ij->n", known, turn).max() - 1.0)
            if np.arccos(min(cosine, 1.0)) > 0.05:
                assert surface_distance_mm(found.mesh, points @ turn.T).max() > DIFFERENT_MM


@pytest.mark.parametrize("name", ["ring", "cylinder", "marble"])
def test_neighbouring_rotations_move_no_point_by_more_than_a_hundredth_of_the_diameter(name):
    found = shapes.make_shape(name)
    turns = found.symmetry.sample_rotations()
    n = len(turns) // len(found.symmetry.rotations)
    points, _normals = sample_surface(found.mesh, 500, seed=2)
    diameter = np.linalg.norm(points[:, None] - points[None], axis=2).max()
    moved = np.linalg.norm(points @ turns[1].T - points @ turns[0].T, axis=1).max()
    around = np.linalg.norm(points @ turns[n - 1].T - points @ turns[0].T, axis=1).max()
    assert 0 < max(moved, around) <= 0.01 * diameter


def test_a_shape_without_symmetry_has_the_identity_alone():
    assert shapes.make_shape("letters").symmetry.sample_rotations().shape == (1, 3, 3)
    assert shapes.make_shape("marble").symmetry.sample_rotations().shape[0] > 1
    with pytest.raises(SettingProblem):
        shapes.make_shape("ring").symmetry.sample_rotations(0.0)


@pytest.mark.parametrize("face", ["-x", "+x", "-y", "+y", "-z", "+z"])
def test_a_users_mesh_lies_on_the_chosen_face(tmp_path, face):
    axis = "xyz".index(face[1])
    sign = 1.0 if face[0] == "+" else -1.0
    corners = np.array([[0, 0, 0], [3, 0, 0], [0, 5, 0], [0, 0, 7]], dtype=float)
    path = tmp_path / "wedge.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    path.write_text("\n".join(lines) + "\n")
    found = shapes.load_mesh_shape(path, face=face)
    v = found.mesh.vertices_mm
    assert found.symmetry.sample_rotations().shape == (1, 3, 3)
    assert v[:, 2].min() == 0.0
    assert np.allclose(v[:, :2].min(axis=0), -v[:, :2].max(axis=0))
    heights = np.sort(-sign * corners[:, axis])
    assert np.allclose(np.sort(v[:, 2]), heights - heights[0])
    a, b, c = (v[found.mesh.triangles[:, k]] for k in range(3))
    # not mirrored
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0 == pytest.approx(3 * 5 * 7 / 6.0)


def test_a_users_mesh_in_another_unit_or_with_an_unknown_face_is_refused(tmp_path):
    path = tmp_path / "small.obj"
    path.write_text(
        "v 0 0 0\nv 0.02 0 0\nv 0 0.02 0\nv 0 0 0.02\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    with pytest.raises(MeshProblem, match="--mesh-unit m"):
        shapes.load_mesh_shape(path)
    assert np.ptp(shapes.load_mesh_shape(path, "m").mesh.vertices_mm[:, 0]) == pytest.approx(20.0)
    with pytest.raises(SettingProblem, match="-z"):
        shapes.load_mesh_shape(path, "m", "down")
    with pytest.raises(FileProblem):
        shapes.load_mesh_shape(tmp_path / "none.stl")


def test_the_labs_tools_can_be_pressed(real_data):
    key = shapes.load_mesh_shape(real_data / "tools" / "hex_key.stl", "m", "+x")
    assert np.ptp(key.mesh.vertices_mm, axis=0).max() == pytest.approx(79.0, abs=0.1)
    assert key.mesh.vertices_mm[:, 2].min() == 0.0
