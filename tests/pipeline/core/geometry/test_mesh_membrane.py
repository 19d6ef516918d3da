from __future__ import annotations

import numpy as np
import pytest

from benchmarks.scenes.rest_mesh import rest_mesh
from pipeline.core.errors import FileProblem, MeshProblem
from pipeline.core.geometry import membrane
from pipeline.core.geometry.membrane import (
    MAX_ERROR_MM,
    compute_lattice_error_mm,
    load_membrane,
    make_mesh_membrane,
)
from pipeline.core.geometry.meshes import Mesh
from pipeline.sensors.spec import load_sensor

DOME = membrane.make_dome_membrane(60.0, 12.0, 30.0, 25.0)
# a cell of 0.5 mm split into triangles against a bilinear one, and cells that straddle
BILINEAR_MM = 2e-3


def sheet(vertices, triangles):
    return Mesh(
        vertices_mm=np.asarray(vertices, float),
        triangles=np.asarray(triangles, np.int32),
        name="sheet",
    )


def write_stl(path, mesh):
    corners = mesh.vertices_mm[mesh.triangles].astype("<f4")
    facets = np.zeros((len(corners), 50), np.uint8)
    facets[:, 12:48] = corners.reshape(len(corners), 9).view(np.uint8)
    path.write_bytes(b"\0" * 80 + len(corners).to_bytes(4, "little") + facets.tobytes())


def test_the_mesh_of_a_dome_is_the_dome():
    found = make_mesh_membrane(rest_mesh(DOME))
    np.testing.assert_allclose(found.z_mm, DOME.z_mm, atol=1e-9)
    assert compute_lattice_error_mm(rest_mesh(DOME), found) < BILINEAR_MM
    points = np.random.default_rng(0).uniform((-25, -20, 50), (25, 20, 80), (3000, 3))
    one = found.signed_distance_mm(points)
    two = DOME.signed_distance_mm(points)
    np.testing.assert_allclose(one, two, atol=1e-9)


def test_another_lattice_stays_within_the_error_that_is_allowed():
    found = make_mesh_membrane(rest_mesh(DOME), step_mm=0.37)
    error_mm = compute_lattice_error_mm(rest_mesh(DOME), found)
    x, y = np.random.default_rng(1).uniform(-17, 17, (2, 500))
    assert np.abs(found.depth_at(x, y) - DOME.depth_at(x, y)).max() < error_mm + BILINEAR_MM
    assert error_mm < 0.01 < MAX_ERROR_MM


def test_a_file_in_metres_is_read_in_its_unit(tmp_path):
    mesh = rest_mesh(DOME)
    write_stl(tmp_path / "rest.stl", sheet(mesh.vertices_mm * 1e-3, mesh.triangles))
    found = load_membrane(tmp_path / "rest.stl", unit="m")
    np.testing.assert_allclose(found.z_mm, DOME.z_mm, atol=1e-4)


@pytest.mark.parametrize(
    ("vertices", "words"),
    [
        ([(0, 0, -5), (9, 0, 20), (0, 9, 20)], "behind the camera"),
        ([(0, 0, 20), (9, 0, 20), (4, 0, 30)], "parallel to z"),
    ],
)
def test_a_mesh_that_cannot_rest_before_a_camera_is_refused(vertices, words):
    with pytest.raises(MeshProblem, match=words):
        make_mesh_membrane(sheet(vertices, [(0, 1, 2)]))


def test_a_mesh_that_folds_and_one_too_fine_for_its_lattice_are_refused(tmp_path):
    mesh = rest_mesh(DOME)
    double = sheet(
        np.concatenate([mesh.vertices_mm, mesh.vertices_mm + np.array([0, 0, 3])]),
        np.concatenate([mesh.triangles, mesh.triangles + len(mesh.vertices_mm)]),
    )
    write_stl(tmp_path / "folded.stl", double)
    with pytest.raises(MeshProblem, match=r"folds over itself .*folded\.stl'$"):
        load_membrane(tmp_path / "folded.stl", unit="mm")
    with pytest.raises(MeshProblem, match="smaller step"):
        make_mesh_membrane(mesh, step_mm=7.0)
    with pytest.raises(MeshProblem, match="larger step"):
        make_mesh_membrane(mesh, step_mm=1e-3)


def described(tmp_path, rest):
    path = tmp_path / "mine.toml"
    path.write_text(f'extends = "soft_bubble"\n[rest]\n{rest}\n')
    return str(path)


def test_a_description_may_name_a_mesh_beside_it(tmp_path):
    bubble = load_sensor("soft_bubble")
    write_stl(tmp_path / "rest.stl", rest_mesh(bubble.membrane))
    found = load_sensor(described(tmp_path, 'kind = "mesh"\nfile = "rest.stl"\nunit = "mm"'))
    # float32 of the file
    np.testing.assert_allclose(found.rest_depth_mm, bubble.rest_depth_mm, atol=1e-4)


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ('kind = "cloth"', "rest.kind"),
        ('kind = "mesh"\nfile = "rest.stl"', "rest.unit"),
        ('kind = "mesh"\nfile = "rest.stl"\nunit = "mm"\nstep = 0', "rest.step"),
    ],
)
def test_a_description_of_a_mesh_that_is_not_understood_is_refused(tmp_path, rest, words):
    with pytest.raises(FileProblem, match=words):
        load_sensor(described(tmp_path, rest))
