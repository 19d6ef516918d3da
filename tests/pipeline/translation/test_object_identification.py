"""The likeliest object of a folder of meshes."""

import numpy as np
import pytest

from pipeline.core.errors import SettingProblem, StageWarning
from pipeline.core.values.results import make_depth_map
from pipeline.physics.simulation import poses, shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.translation.object_identification import identify_object

GEL = load_sensor("gelslim")
NAMES = ("letters", "cone", "star")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    for name in NAMES:
        mesh = shapes.make_shape(name).mesh
        lines = ["v {} {} {}".format(*v) for v in mesh.vertices_mm.tolist()]
        lines += ["f {} {} {}".format(*(t + 1)) for t in mesh.triangles]
        (folder / f"{name}.obj").write_text("\n".join(lines))
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_the_object_that_was_pressed_is_named_with_its_margin(folder, name):
    mesh = shapes.make_shape(name).mesh
    press = simulate_press(mesh, poses.make_paper_grid(mesh, n=1, seed=2)[0], GEL, seed=None)
    depth = make_depth_map(GEL.rest_depth_mm, press.indentation_mm, press.contact, GEL.camera)
    found = identify_object(depth, GEL, folder, "mm")
    assert found.path.stem == name
    assert f"the likeliest of 3 objects is {name}" in found.note
    assert "the next is" in found.note
    assert not isinstance(found.note, StageWarning)


def test_two_copies_of_one_object_are_not_certain(folder, tmp_path):
    for copy in ("one.obj", "two.obj"):
        (tmp_path / copy).write_text((folder / "star.obj").read_text())
    mesh = shapes.make_shape("star").mesh
    press = simulate_press(mesh, poses.make_paper_grid(mesh, n=1, seed=2)[0], GEL, seed=None)
    depth = make_depth_map(GEL.rest_depth_mm, press.indentation_mm, press.contact, GEL.camera)
    assert isinstance(identify_object(depth, GEL, tmp_path, "mm").note, StageWarning)


def test_a_folder_without_meshes_is_named(tmp_path):
    flat = np.zeros(GEL.camera.shape, np.float32)
    depth = make_depth_map(GEL.rest_depth_mm, flat, flat > 0, GEL.camera)
    with pytest.raises(SettingProblem, match="--meshes needs a folder"):
        identify_object(depth, GEL, tmp_path)
