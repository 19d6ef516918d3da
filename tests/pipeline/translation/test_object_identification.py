"""The likeliest object of a folder of meshes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tactoscope as ts
from pipeline.core.errors import SettingProblem, StageWarning
from pipeline.core.values.results import make_depth_map
from pipeline.physics.sensor_images import render_reference
from pipeline.physics.simulation import poses, shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.translation.object_identification import identify_object
from sample_data.make_samples import RECORDINGS_FOLDER

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


@pytest.fixture(scope="module")
def press():
    """Images of a press of the star, without any mesh beside them."""
    mesh = shapes.make_shape("star").mesh
    at = simulate_press(mesh, poses.make_paper_grid(mesh, n=1, seed=2)[0], GEL, seed=1)
    return [render_reference(GEL), at.image]


def test_the_default_goes_through_the_object_where_its_mesh_is_known(folder, press):
    def open_touches(**options):
        images = np.stack(press)
        return ts.open(images, "soft_bubble", source="gelslim", reference=press[0], **options)

    plain = open_touches()
    assert plain.route.name == "t2d2"
    assert "object" not in plain.list_methods("touch")
    touches = open_touches(meshes=folder, mesh_unit="mm")
    assert touches.route.name == "object"
    assert "the likeliest of 3 objects is star" in touches.notes[-1]
    touch = touches[1].result("touch")
    assert touch.method.name == "object"
    assert not touch.fallback
    for chosen in (
        touches.with_(method="t2d2"),
        open_touches(mesh=folder / "cone.obj", route="t2d2"),
    ):
        assert chosen.get_method("touch").name == "t2d2"
    with pytest.raises(ts.TouchError, match="either mesh"):
        open_touches(mesh=folder / "cone.obj", meshes=Path(folder))


def test_a_mesh_that_does_not_fit_is_refused_and_t2d2_answers(press):
    small = shapes.make_shape("letters").mesh
    small = replace(small, vertices_mm=0.1 * small.vertices_mm)
    images = np.stack(press)
    touches = ts.open(images, "soft_bubble", source="gelslim", reference=press[0], mesh=small)
    touch = touches[1].result("touch")
    assert touch.fallback.startswith("T2D2: ")
    assert "mesh" in touch.fallback
    by_t2d2 = touches.with_(method="t2d2")[1].touch
    assert touch.output.image.tobytes() == by_t2d2.image.tobytes()


def test_a_setting_of_another_method_names_it(folder, press):
    images = np.stack(press)
    with (
        ts.open(
            images, "soft_bubble", source="gelslim", reference=press[0], mesh=folder / "star.obj"
        ) as touches,
        pytest.raises(ts.TouchError, match=r"no parameter 'steps'.*touch=t2d2"),
    ):
        touches.with_(steps=8)


@pytest.mark.parametrize("seed", [0, 2])
def test_a_true_mesh_is_not_refused_where_the_depth_says_that_it_is_wrong(seed):
    """Frame 3: 63 % of its touch are saturated. From these points the registration ends on a side
    of the object, 30 mm off, which fits the contact as well.
    """
    with ts.open(RECORDINGS_FOLDER / "trouble.h5", "soft_bubble") as touches:
        touch = touches.with_(seed=seed)[3].result("touch")
    assert touch.method.name == "object"
    assert not touch.fallback
