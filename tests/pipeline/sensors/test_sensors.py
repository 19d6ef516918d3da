from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.digests import compute_digest, is_frozen
from pipeline.core.errors import CalibrationError, FileProblem, SettingProblem
from pipeline.sensors import spec
from pipeline.sensors.parts import DepthCamera
from pipeline.sensors.spec import list_sensor_names, load_sensor

FOLDER = Path(spec.__file__).parent


def own(tmp_path, text, name="mine.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", list_sensor_names())
def test_every_sensor_of_the_project_is_valid(name):
    s = load_sensor(name)
    assert s.rest_depth_mm.shape == s.camera.shape
    assert np.isfinite(s.rest_depth_mm).all()
    assert not s.rest_depth_mm.flags.writeable
    np.testing.assert_allclose(np.linalg.det(s.alignment_from_sensor[:3, :3]), 1.0)
    assert (s.kind == "gel") == (s.gel is not None) == (s.optics is not None)
    assert (s.kind == "bubble") == (s.bubble is not None)


def test_the_scale_of_the_paper_is_kept():
    assert 1 / load_sensor("gelslim").pixel_mm == pytest.approx(23.72, rel=1e-3)
    bubble = load_sensor("soft_bubble")
    assert bubble.camera.fx_px / bubble.rest_depth_mm.max() == pytest.approx(2.36, rel=0.02)
    assert bubble.camera.shape == (140, 175)
    assert load_sensor("gelslim").camera.shape == (320, 427)


def test_a_variant_differs_from_its_parent_only_where_stated():
    dotted = load_sensor("gelslim")
    dotless = load_sensor("gelslim_dotless")
    assert dotted.markers is not None
    assert dotless.markers is None
    assert dotless.camera == dotted.camera
    assert dotless.title != dotted.title


def test_a_users_sensor_may_extend_one_of_the_project(tmp_path):
    text = (
        '\ufeffextends = "digit"\ntitle = "my digit"\n[rest]\ndepth = { value = 30.0, unit = '
        '"mm", from = "measured" }\n'
    )
    s = load_sensor(own(tmp_path, text))
    assert s.title == "my digit"
    assert s.rest_depth_mm.mean() == pytest.approx(30.0)
    assert "rest.depth" not in s.assumed_keys
    assert s.camera == load_sensor("digit").camera


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "[gel]\nthicknes = {}",
            r"gel\.thicknes; do you mean gel\.thickness\? Known are poisson, thickness, youngs",
        ),
        ("[optics]\nglowz = []", r"optics\.glowz; do you mean optics\.glows"),
        ("[marker]\npitch = {}", "marker; do you mean markers"),
        ('titel = "my digit"', "titel; do you mean title"),
        (
            '[rest]\ndepth = {value = 20.0, unit = "mm", from = "measured", asumed = true}',
            "unknown field asumed",
        ),
    ],
)
def test_a_misspelled_key_is_named_with_the_one_that_is_meant(tmp_path, text, words):
    text = text.replace("{}", '{ value = 2.0, unit = "mm", from = "measured" }')
    with pytest.raises((CalibrationError, FileProblem), match=rf"{words}.*mine\.toml"):
        load_sensor(own(tmp_path, f'extends = "digit"\n{text}\n'))


def test_an_edited_description_is_read_again(tmp_path):
    depth = '[rest]\ndepth = {{ value = {}, unit = "mm", from = "measured" }}\n'
    parent = own(tmp_path, 'extends = "digit"\n' + depth.format("30.0"), name="parent.toml")
    child = own(tmp_path, 'extends = "parent"\ntitle = "mine"\n')
    first = load_sensor(child)
    assert load_sensor(child) is first
    assert load_sensor(parent).rest_depth_mm.mean() == pytest.approx(30.0)
    own(tmp_path, 'extends = "digit"\n' + depth.format("31.0"), name="parent.toml")
    assert load_sensor(child).rest_depth_mm.mean() == pytest.approx(31.0)
    own(tmp_path, 'extends = "parent"\ntitle = "yours"\n')
    assert load_sensor(child).title == "yours"


@pytest.mark.parametrize("name", list_sensor_names())
def test_a_sensor_is_immutable(name):
    assert is_frozen(load_sensor(name))
    assert is_frozen(load_sensor(name).with_camera(load_sensor(name).camera.scale(0.5)))


def test_a_sensor_with_another_camera_keeps_everything_else():
    source = load_sensor("soft_bubble")
    small = source.with_camera(source.camera.scale(0.25))
    assert source.with_camera(source.camera) is source
    assert small.rest_depth_mm.shape == small.camera.shape
    assert compute_digest(
        replace(small, camera=source.camera, rest_depth_mm=source.rest_depth_mm)
    ) == compute_digest(source)
    quiet = replace(source, limits=replace(source.limits, no_contact_change=9.0))
    assert quiet.with_camera(small.camera).limits == quiet.limits


@pytest.mark.parametrize("text", ["without = 3", "[kind]\nvalue = 1"])
def test_sections_of_the_wrong_type_are_refused(tmp_path, text):
    with pytest.raises((CalibrationError, FileProblem), match="must be"):
        load_sensor(own(tmp_path, f'extends = "digit"\n{text}\n'))


def test_an_unknown_sensor_names_the_known_ones():
    with pytest.raises(SettingProblem, match=r"unknown sensor 'gelslimm'.*gelslim"):
        load_sensor("gelslimm")


@pytest.mark.parametrize(
    ("find", "replacement", "words"),
    [
        ('unit = "px"', 'unit = "mm"', "must be given in 'px'"),
        ("rows = {", "lines = {", r"image\.rows: expected a table"),
        ("[camera]", "[lens]", r"lacks the section \[camera\]"),
        ('kind = "gel"', 'kind = "skin"', "kind must be"),
        ("value = 240", "value = -240", "must lie within"),
        (
            "fx = { value = 394.32",
            "fx = { value = 0.0",
            "camera.fx must lie within 32 and 100000 px",
        ),
        ("fx = { value = 394.32", "fx = { value = 3.6", "camera.fx must lie within 32"),
        ("value = [0.0, 0.0, -25.0]", "value = [0.0, 0.0]", "list of 3"),
        ("fx = { value = 394.32", "fx = { value = nan", r"camera\.fx\.value: expected a number"),
        ("elevation_deg = 30.0, ", "", r"optics\.leds\[0\]\.elevation_deg: it is missing"),
    ],
)
def test_an_invalid_description_is_refused_with_its_problem(tmp_path, find, replacement, words):
    text = (FOLDER / "gelsight_mini.toml").read_text(encoding="utf-8")
    assert find in text
    with pytest.raises((CalibrationError, FileProblem), match=words):
        load_sensor(own(tmp_path, text.replace(find, replacement)))


def entry(key, value, unit):
    return f'{key} = {{ value = {value}, unit = "{unit}", from = "a slip" }}\n'


CAMERA = "[camera]\n" + "".join(entry(key, "100.0", "px") for key in ("fx", "fy", "cx", "cy"))


@pytest.mark.parametrize(
    ("section", "line", "words"),
    [
        (
            "alignment",
            entry("rotation_vector", "[1e20, 0.0, 0.0]", "deg"),
            r"rotation_vector\.value\[0\]: expected a number <= 1000000000",
        ),
        (
            "alignment",
            entry("rotation_vector", "[0.0, 361.0, 0.0]", "deg"),
            "within -360 and 360 deg",
        ),
        (
            "alignment",
            entry("translation", "[0.0, 0.0, 1000001.0]", "mm"),
            "within -1000 and 1000 mm",
        ),
        (
            "bubble",
            entry("pressure", "1e300", "kPa"),
            r"bubble\.pressure\.value: expected a number <=",
        ),
        ("bubble", entry("pressure", "101.0", "kPa"), "within 0 and 100 kPa"),
        (
            "bubble",
            entry("dead_volume", "1" + "0" * 400, "mm^3"),
            r"bubble\.dead_volume\.value: Number out of range",
        ),
        ("camera", entry("fx", "1e9", "px"), "within 17.5 and 100000 px"),
        ("camera", entry("cx", "-1e7", "px"), "within -100000 and 100000 px"),
        ("camera", entry("fy", "true", "px"), "expected a number or a list, got true or false"),
        ("camera", entry("fy", "[[1.0]]", "px"), r"fy\.value\[0\]: expected a number, got a list"),
        ("image", entry("rows", "1", "px") + CAMERA, "within 8 and 10000 px"),
        ("image", entry("rows", "80.5", "px") + CAMERA, "must be whole numbers, got 80.5 and 175"),
        ("image", entry("rows", "80", "px"), "is not that of soft_bubble, .*give cx"),
        ("rest", entry("rim_depth", "1979-05-27", "mm"), r"rim_depth\.value: expected a number"),
    ],
)
def test_numbers_out_of_range_are_refused_with_the_range(tmp_path, section, line, words):
    with pytest.raises((CalibrationError, FileProblem), match=words):
        load_sensor(own(tmp_path, f'extends = "soft_bubble"\n[{section}]\n{line}'))


def test_a_deeply_nested_description_is_refused(tmp_path):
    with pytest.raises(FileProblem, match="not valid TOML"):
        load_sensor(own(tmp_path, f"extends = {'[' * 20_000}"))


def test_a_missing_or_garbled_file_is_named(tmp_path):
    with pytest.raises(FileProblem, match="nowhere"):
        load_sensor(str(tmp_path / "nowhere.toml"))
    with pytest.raises(FileProblem, match="not valid TOML"):
        load_sensor(own(tmp_path, "rows = = 3"))
    with pytest.raises(FileProblem, match="extends"):
        load_sensor(own(tmp_path, "extends = 3", name="third.toml"))


def test_a_description_that_extends_itself_is_refused(tmp_path):
    with pytest.raises(FileProblem, match="extends"):
        load_sensor(own(tmp_path, 'extends = "loop"', name="loop.toml"))


def test_a_value_of_the_wrong_type_is_refused(tmp_path):
    text = (FOLDER / "gelsight_mini.toml").read_text(encoding="utf-8")
    with pytest.raises(FileProblem, match="number"):
        load_sensor(own(tmp_path, text.replace("value = 240", 'value = "many"')))


def test_a_list_where_one_number_belongs_is_refused(tmp_path):
    text = (FOLDER / "gelsight_mini.toml").read_text(encoding="utf-8")
    with pytest.raises(CalibrationError, match="number"):
        load_sensor(own(tmp_path, text.replace("value = 240", "value = [240, 1]")))


def test_a_bubble_has_a_depth_camera_with_errors_and_a_stereo_variant(tmp_path):
    flight = load_sensor("soft_bubble")
    stereo = load_sensor("soft_bubble_stereo")
    assert flight.depth_camera == DepthCamera()  # what a description without the section gets
    assert (stereo.depth_camera.gap_share, stereo.depth_camera.step_mm) == (0.01, 0.1)
    assert stereo.depth_camera.distance_power == flight.depth_camera.distance_power
    assert stereo.bubble == flight.bubble
    assert load_sensor("gelslim").depth_camera is None
    some = '[depth_camera]\ngap_share = { value = 0.2, unit = "1", from = "counted" }\n'
    assert (
        load_sensor(own(tmp_path, f'extends = "soft_bubble"\n{some}')).depth_camera.gap_share == 0.2
    )
    with pytest.raises(CalibrationError, match=r"depth_camera\.gap_share.*0 and 1"):
        load_sensor(
            own(tmp_path, f'extends = "soft_bubble"\n{some.replace("0.2", "1.2")}', "other.toml")
        )
