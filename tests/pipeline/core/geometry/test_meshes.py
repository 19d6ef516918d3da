"""Meshes: formats, units, and points on their surface."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import FileProblem, MeshProblem, SettingProblem
from pipeline.core.geometry.meshes import Mesh, load_mesh, sample_surface, triangulate_polygon

CORNERS = np.array([[0.0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
FLOAT_ROUNDING_MM = 1e-5  # of float32 at 20 mm, with a margin


def binary_stl(
    path: Path, corners: np.ndarray, faces: np.ndarray = FACES, header: bytes = b""
) -> Path:
    facets = b"".join(
        bytes(12) + corners[face].astype("<f4").tobytes() + bytes(2) for face in faces
    )  # no normal, no colour
    path.write_bytes(header.ljust(80, b" ") + len(faces).to_bytes(4, "little") + facets)
    return path


def text_stl(path: Path, corners: np.ndarray) -> Path:
    lines = ["solid corner"]
    for face in FACES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in corners[face]]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid corner"]))
    return path


def text_ply(path: Path, corners: np.ndarray) -> Path:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\nproperty float x\nproperty "
        "float y\nproperty float z\n"
    )
    head += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    body = [" ".join(map(str, v)) for v in corners] + [f"3 {a} {b} {c}" for a, b, c in FACES]
    path.write_text(head + "\n".join(body) + "\n")
    return path


def obj(path: Path, corners: np.ndarray) -> Path:
    body = [f"v {x} {y} {z}" for x, y, z in corners] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES
    ]
    path.write_text("\n".join(body) + "\n")
    return path


@pytest.mark.parametrize(
    ("write", "name"),
    [(binary_stl, "a.stl"), (text_stl, "a.STL"), (text_ply, "a.ply"), (obj, "a.obj")],
)
def test_every_format_gives_the_same_mesh_with_vertices_merged(tmp_path: Path, write, name: str):
    mesh = load_mesh(write(tmp_path / name, CORNERS))
    assert mesh.name == "a"
    assert mesh.vertices_mm.shape == (4, 3)
    want = {tuple(sorted(map(tuple, CORNERS[f]))) for f in FACES}
    got = {tuple(sorted(map(tuple, np.round(mesh.vertices_mm[f], 4)))) for f in mesh.triangles}
    assert got == want
    assert not mesh.vertices_mm.flags.writeable


def test_faces_of_an_obj_become_fans_however_their_corners_are_named(tmp_path: Path):
    """A cube of quads, a face of five corners, and corners counted back from the latest vertex."""
    vertices = [(x, y, z) for x in (0, 9) for y in (0, 9) for z in (0, 9)]
    sides = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    head = "".join(f"v {x} {y} {z} 1.0\n" for x, y, z in vertices) + "vt 0 0\nvn 0 0 1\n"
    for name, corner in {
        "plain": lambda k: f"{k}",
        "texture": lambda k: f"{k}/1",
        "both": lambda k: f"{k}/1/1",
        "normal": lambda k: f"{k}//1",
        "backward": lambda k: f"{k - 9}",
    }.items():
        path = tmp_path / f"{name}.obj"
        path.write_text(
            head + "".join(f"f {' '.join(corner(k) for k in side)}\n" for side in sides)
        )
        mesh = load_mesh(path)
        assert len(mesh.triangles) == 12, name
        a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
        # closed, and every quad once
        assert (a * np.cross(b, c)).sum() / 6.0 == pytest.approx(9.0**3), name
    mixed = tmp_path / "mixed.obj"
    mixed.write_text("v 0 0 0\nv 9 0 0\nv 12 5 0\nv 9 9 0\nv 0 9 0\nf 1 2 3 \\\n4 5\nf 1 3 2\n")
    assert len(load_mesh(mixed).triangles) == 4


@pytest.mark.parametrize(
    "face", ["f 1 2", "f 1 2 0", "f 1 2 x", "f 1 2 -9", "v 1 2", "v 1 2 three", "f 1 2 99999999999"]
)
def test_lines_of_an_obj_that_are_no_vertex_and_no_face_are_named(tmp_path: Path, face: str):
    path = tmp_path / "a.obj"
    path.write_text(f"v 0 0 0\nv 9 0 0\nv 0 9 0\n{face}\n")
    with pytest.raises(FileProblem, match="line 4 of the OBJ file is no vertex and no face"):
        load_mesh(path)


@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.ply"])
def test_a_pipe_is_no_mesh(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileProblem, match="a pipe or a device"):
        load_mesh(tmp_path / name)


def test_a_binary_file_that_begins_like_text_is_read_as_binary(tmp_path: Path):
    assert (
        len(load_mesh(binary_stl(tmp_path / "a.stl", CORNERS, header=b"solid trap")).triangles) == 4
    )


def test_metres_are_refused_with_what_to_try_and_read_when_said(tmp_path: Path):
    path = binary_stl(tmp_path / "a.stl", CORNERS / 1000.0)
    with pytest.raises(
        MeshProblem, match=r"0\.02 mm large when read in mm; try --mesh-unit m: .*a\.stl"
    ):
        load_mesh(path)
    np.testing.assert_allclose(
        load_mesh(path, unit="m").vertices_mm.max(axis=0), 20.0, atol=FLOAT_ROUNDING_MM
    )


@pytest.mark.parametrize("unit", ["in", "inch"])
def test_inches_are_read_when_said_and_named_where_they_can_be_meant(tmp_path: Path, unit):
    path = binary_stl(tmp_path / "a.stl", CORNERS / 25.4)
    np.testing.assert_allclose(
        load_mesh(path, unit=unit).vertices_mm.max(axis=0), 20.0, atol=FLOAT_ROUNDING_MM
    )
    with pytest.raises(
        MeshProblem, match=r"787 mm large when read in m; try --mesh-unit cm or in: "
    ):
        load_mesh(path, unit="m")


def test_millimetres_called_metres_are_refused(tmp_path: Path):
    with pytest.raises(MeshProblem, match=r"2e\+04 mm large when read in m; try --mesh-unit cm|mm"):
        load_mesh(binary_stl(tmp_path / "a.stl", CORNERS), unit="m")
    with pytest.raises(SettingProblem, match="unknown mesh unit 'feet'"):
        load_mesh(tmp_path / "a.stl", unit="feet")


def test_triangles_without_area_are_dropped(tmp_path: Path):
    faces = np.vstack([FACES, [0, 1, 1]])
    assert len(load_mesh(binary_stl(tmp_path / "a.stl", CORNERS, faces)).triangles) == 4
    with pytest.raises(MeshProblem, match="no triangle of the mesh has an area"):
        load_mesh(binary_stl(tmp_path / "b.stl", CORNERS, np.array([[0, 1, 1]])))


@pytest.mark.parametrize(
    ("content", "error", "message"),
    [
        (b"", FileProblem, "cut short or damaged"),
        (b" " * 80 + bytes(4), MeshProblem, "has no triangles"),
        (
            b" " * 80 + (7).to_bytes(4, "little") + bytes(60),
            FileProblem,
            "cut short or damaged: 7 triangles",
        ),
        (b"solid a\nfacet\nvertex 1 2 3\n", FileProblem, "text STL is cut short"),
        (b"solid a\nvertex 1 2 x\nendsolid", FileProblem, "not three numbers"),
    ],
)
def test_damaged_stl_files_are_refused(tmp_path: Path, content: bytes, error, message: str):
    (tmp_path / "a.stl").write_bytes(content)
    with pytest.raises(error, match=message):
        load_mesh(tmp_path / "a.stl")


def test_vertices_that_are_not_finite_are_refused(tmp_path: Path):
    corners = CORNERS.copy()
    corners[2, 1] = np.nan
    with pytest.raises(MeshProblem, match="not finite"):
        load_mesh(binary_stl(tmp_path / "a.stl", corners))


def test_other_files_and_missing_ones_are_refused(tmp_path: Path):
    with pytest.raises(FileProblem, match=r"no such file|No such file"):
        load_mesh(tmp_path / "a.stl")
    with pytest.raises(FileProblem, match="No such file"):
        load_mesh(tmp_path / "a.ply")
    with pytest.raises(FileProblem, match="meshes are read from STL, PLY and OBJ"):
        load_mesh(tmp_path / "a.step")
    (tmp_path / "b.ply").write_text("nothing")
    with pytest.raises(MeshProblem, match="has no triangles"):
        load_mesh(tmp_path / "b.ply")


def measure(mesh: Mesh) -> tuple[float, float]:
    """(area, volume)."""
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()), float(
        (a * np.cross(b, c)).sum()
    ) / 6.0


def write_prism(path: Path, outline, height: float = 6.0) -> Path:
    """A prism whose ends are one face each."""
    n = len(outline)
    corners = [(x, y, z) for z in (0.0, height) for x, y in outline]
    faces = [
        range(n)[::-1],
        range(n, 2 * n),
        *((i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)),
    ]
    path.write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
        + "".join("f " + " ".join(str(i + 1) for i in face) + "\n" for face in faces)
    )
    return path


def test_a_concave_face_is_not_filled(tmp_path: Path):
    u = [(0, 0), (15, 0), (15, 12), (10, 12), (10, 4), (5, 4), (5, 12), (0, 12)]
    assert measure(load_mesh(write_prism(tmp_path / "u.obj", u))) == pytest.approx((700.0, 840.0))
    # with a hole
    ring = [(0, 0), (20, 0), (20, 20), (0, 20), (0, 0), (5, 5), (5, 15), (15, 15), (15, 5), (5, 5)]
    assert measure(load_mesh(write_prism(tmp_path / "ring.obj", ring)))[1] == pytest.approx(
        300.0 * 6
    )
    crossed = [(0, 0), (10, 10), (10, 0), (0, 8)]
    with pytest.raises(FileProblem, match="line 9 of the OBJ file has a face that crosses itself"):
        load_mesh(write_prism(tmp_path / "crossed.obj", crossed))


@given(n=st.integers(4, 40), seed=st.integers(0, 10_000), degenerate=st.booleans())
def test_stars_are_cut_into_triangles_of_their_area(n, seed, degenerate):
    """Outlines that are seen whole from one point, turned anyhow in space, some with corners on
    a line.
    """
    rng = np.random.default_rng(seed)
    angles = np.arange(n) * 2 * np.pi / n
    radii = rng.uniform(2.0, 10.0, n)
    flat = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(n)], axis=1)
    if degenerate:
        flat = np.stack([flat, 0.5 * (flat + np.roll(flat, -1, axis=0))], axis=1).reshape(-1, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = flat @ turn.T + rng.uniform(-50, 50, 3)
    area = 0.5 * np.linalg.norm(np.cross(flat, np.roll(flat, -1, axis=0)).sum(axis=0))
    cuts = np.array(triangulate_polygon(points))
    a, b, c = (points[cuts[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    assert 0.5 * np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=1e-6)
    assert 0.5 * np.linalg.norm(normals.sum(axis=0)) == pytest.approx(area, rel=1e-6), (
        "all turned alike"
    )
    assert len(cuts) == len(points) - 2


@pytest.mark.parametrize(
    ("extent", "is_certain"), [(3.75, False), (1.48, False), (1.0, False), (6.0, True)]
)
def test_a_mesh_smaller_than_a_contact_asks_for_its_unit(
    tmp_path: Path, extent: float, is_certain: bool
):
    path = binary_stl(tmp_path / "a.stl", CORNERS * (extent / 20.0))
    if is_certain:
        assert load_mesh(path).vertices_mm.max() == pytest.approx(extent)
        return
    with pytest.raises(MeshProblem, match=r"try --mesh-unit .*mm"):
        load_mesh(path)
    assert load_mesh(path, unit="mm").vertices_mm.max() == pytest.approx(extent)


def write_urdf(path: Path, name: str, scale: str, more: str = "") -> Path:
    geometry = f'<geometry><mesh filename="{name}" scale="{scale}"/></geometry>'
    path.write_text(
        f'<robot name="x"><link name="a"><visual>{geometry}</visual>{more}</link></robot>'
    )
    return path


def test_a_urdf_scales_its_mesh_and_is_in_metres(tmp_path: Path):
    (tmp_path / "urdf").mkdir()
    (tmp_path / "meshes").mkdir()
    unit_cube = [(0, 0), (1, 0), (1, 1), (0, 1)]
    write_prism(tmp_path / "meshes" / "cube.obj", unit_cube, height=1.0)
    for name in ("../meshes/cube.obj", "package://thing/meshes/cube.obj"):
        mesh = load_mesh(write_urdf(tmp_path / "urdf" / "a.urdf", name, "0.05 0.04 -0.03"))
        assert np.ptp(mesh.vertices_mm, axis=0) == pytest.approx([50.0, 40.0, 30.0])
        assert measure(mesh)[1] == pytest.approx(60_000.0), "not inside out"
    for urdf, words in (
        (write_urdf(tmp_path / "b.urdf", "meshes/cube.obj", "1 1"), "no three numbers"),
        (write_urdf(tmp_path / "c.urdf", "../../etc/passwd", "1 1 1"), "is not in its folder"),
        (
            write_urdf(
                tmp_path / "d.urdf",
                "meshes/cube.obj",
                "1 1 1",
                '<collision><geometry><mesh filename="b.stl"/></geometry></collision>',
            ),
            "must name one mesh",
        ),
    ):
        with pytest.raises(FileProblem, match=words):
            load_mesh(urdf)


def test_samples_lie_on_the_surface_and_follow_its_area():
    mesh = Mesh(vertices_mm=CORNERS, triangles=FACES.astype(np.int32))
    points, normals = sample_surface(mesh, 8000, seed=3)
    again, _ = sample_surface(mesh, 8000, seed=3)
    assert points.tobytes() == again.tobytes()
    on_plane = np.isclose(points, 0.0, atol=1e-9).any(axis=1) | np.isclose(
        points.sum(axis=1), 20.0, atol=1e-9
    )
    assert on_plane.all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    slanted = np.isclose(normals, 3**-0.5).all(axis=1)
    # of the area: the slanted face against three right triangles
    share = np.sqrt(3) / (np.sqrt(3) + 3)
    four_sigma = 4 * np.sqrt(share * (1 - share) / 8000)
    assert abs(slanted.mean() - share) < four_sigma
    inside = points[slanted].mean(axis=0)
    # mm; four standard errors of the mean of 2900 points are 0.35
    np.testing.assert_allclose(inside, 20 / 3, atol=0.5)


def test_real_tools_are_read_in_their_units(real_data: Path):
    assert np.ptp(load_mesh(real_data / "tools" / "peg1.stl").vertices_mm[:, 2]) == pytest.approx(
        80.0, abs=0.1
    )
    tool = real_data / "tools" / "pattern_01_2_lines_angle_1.stl"
    with pytest.raises(MeshProblem, match="try --mesh-unit m"):
        load_mesh(tool)
    assert np.ptp(load_mesh(tool, unit="m").vertices_mm[:, 0]) == pytest.approx(37.0, abs=0.1)
