"""The public module: what it loads, when it computes, and what it says to a mistake."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tactoscope as ts
from pipeline.core.errors import SettingProblem, ShapeError
from pipeline.core.graph import Graph

SAMPLE = Path(__file__).parents[1] / "sample_data" / "recordings" / "first_touch.h5"
TOUCHED = 5
UNTOUCHED = 0
SHAPE = (320, 240, 3)  # of a DIGIT


@pytest.fixture(scope="module")
def touches():
    with ts.open(SAMPLE, "gelslim", source="digit", methods={"touch": "physics"}) as opened:
        yield opened


@pytest.fixture
def evaluated(monkeypatch):
    """The stages that are asked for from now on."""
    asked = []
    evaluate = Graph.evaluate

    def follow(self, wanted, *args, **kwargs):
        asked.append(tuple(wanted))
        return evaluate(self, wanted, *args, **kwargs)

    monkeypatch.setattr(Graph, "evaluate", follow)
    return asked


@pytest.mark.parametrize(
    ("command", "heavy"),
    [
        ("import tactoscope; dir(tactoscope)", "numpy"),
        (
            "import tactoscope, sys; sys.argv[1:] = ['--help']\ntry: tactoscope.main()\nexcept "
            "SystemExit: pass",
            "numpy",
        ),
        (
            f"import tactoscope; len(tactoscope.open({str(SAMPLE)!r}, 'gelslim', source='digit'))",
            "torch",
        ),
    ],
)
def test_it_loads_no_library_before_it_is_needed(command, heavy):
    code = f"{command}\nimport sys\nassert {heavy!r} not in sys.modules"
    subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        cwd=SAMPLE.parents[2],
        timeout=120,
    )


def test_every_public_name_is_there_and_says_what_it_is():
    assert sorted(ts.__all__) == dir(ts)
    for name in ts.__all__:
        assert getattr(ts, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = ts.nothing


def test_nothing_is_computed_until_it_is_asked_for(touches, evaluated):
    frames = list(touches)
    assert [frame.index for frame in frames] == list(range(len(touches)))
    frame = touches[TOUCHED]
    assert frame.image.shape == SHAPE
    assert evaluated == []
    assert frame.depth is frame.depth
    assert evaluated == [("depth",)]
    assert "computed: depth" in repr(frame)
    assert set(frame.results) == set(touches.stages)


def test_what_is_opened_prints_as_one_line(touches):
    assert repr(touches) == "<16 frames of digit -> gelslim: 'first_touch.h5'>"
    printed = repr(touches.recording)
    assert "'first_touch.h5': 16 frames of " in printed
    assert len(printed) < 200


def test_frames_are_counted_from_both_ends(touches):
    assert touches[-1].index == len(touches) - 1
    assert touches[np.int64(2)].index == 2
    for index in (len(touches), -99):
        with pytest.raises(SettingProblem, match=f"no frame {index};"):
            touches[index]
    for index in (slice(2, 4), "5", 1.5):
        with pytest.raises(SettingProblem, match="a frame is chosen by its number, got"):
            touches[index]


def test_a_frame_has_what_the_stages_made_of_it(touches):
    frame = touches[TOUCHED]
    assert frame.touch.image.shape == (*touches.target.camera.shape, 3)
    assert frame.pose.matrix.shape == (4, 4)
    assert frame.metrics["depth.contact_iou"] > 0.8
    assert all(note.partition(": ")[0] in touches.stages for note in frame.notes)
    assert frame._repr_html_().count("data:image/png;base64,") == len(touches.stages)


def test_what_only_the_truth_knows_is_a_note():
    with ts.open(SAMPLE, "soft_bubble", source="gelslim", methods={"touch": "physics"}) as opened:
        assert any(
            "of the target's contact: the rest is missing" in note for note in opened[TOUCHED].notes
        )


def test_other_settings_compute_only_what_follows(touches):
    touches.evaluate(TOUCHED)
    states = {
        name: result.state
        for name, result in touches.with_(stage="pose", seed=7)[TOUCHED].results.items()
    }
    assert states.pop("pose") == "computed"
    assert set(states.values()) == {"cached"}


@pytest.mark.parametrize(
    ("change", "fact"),
    [
        ({"stage": "nothing", "gain": 1.0}, "no stage 'nothing'"),
        ({"method": "nothing"}, "no method 'nothing'"),
        ({"nothing": 1}, "no parameter 'nothing'"),
        ({"stage": "depth", "sensitivity": -1.0}, "sensitivity must lie within"),
    ],
)
def test_a_wrong_name_is_one_sentence(touches, change, fact):
    with pytest.raises(ts.TouchError, match=fact):
        touches.with_(**change)


def test_methods_that_can_answer_are_listed(touches):
    assert "network" not in touches.list_methods("depth"), "it is for bubbles"
    for name in touches.list_methods("touch"):
        assert not touches.with_(method=name)[TOUCHED].result("touch").fallback


def test_a_method_that_is_written_again_is_run_again(touches):
    depth = touches.get_method("depth")

    def make(shift_mm):
        def run(*reads):
            measured = depth.run(*reads)
            return replace(measured, indentation_mm=measured.indentation_mm + np.float32(shift_mm))

        return replace(depth, name="mine", title="Mine", run=run, nodes=())

    first, second = (
        touches.with_(stage="depth", method=make(mm))[TOUCHED].depth for mm in (0.0, 1.0)
    )
    np.testing.assert_allclose(second.indentation_mm - first.indentation_mm, 1.0, atol=1e-5)
    assert "mine" not in touches.list_methods("depth")
    with pytest.raises(SettingProblem, match="already has a method 'physics'"):
        touches.with_(stage="depth", method=replace(make(0.0), name="physics"))


def test_an_own_method_says_its_stage_and_returns_what_the_stage_is(touches):
    depth = touches.get_method("depth")
    mine = replace(depth, name="mine", title="Mine", run=depth.run, nodes=())
    assert touches.with_(method=mine)[TOUCHED].result("depth").method.name == "mine"
    wrong = replace(mine, run=lambda *_reads: np.zeros((3, 3)))
    with pytest.raises(SettingProblem, match="by 'Mine' returned a ndarray; return a DepthMap"):
        _ = touches.with_(method=wrong)[TOUCHED].touch
    for give in (
        lambda: touches.with_(stage="depth", method=depth.run),
        lambda: ts.open(SAMPLE, "gelslim", source="digit", methods={"depth": depth.run}),
    ):
        with pytest.raises(SettingProblem, match=r"a method is a name or a Method, .*ts\.Method\("):
            give()


def test_arrays_give_the_depth_of_their_recording(touches):
    source = touches[TOUCHED].source
    with ts.open([source.image], "gelslim", source="digit", reference=source.reference) as opened:
        alone = opened[0].depth
    given = ts.depth(source.image, source.reference, sensor="digit")
    assert np.array_equal(given.indentation_mm, alone.indentation_mm)
    assert given.contact.any()
    assert not ts.depth(source.reference, source.reference, sensor="digit").contact.any()


def test_the_reference_of_arrays_may_be_a_file(touches, tmp_path):
    source = touches[TOUCHED].source
    file = str(tmp_path / "ref.png")
    cv2.imwrite(file, source.reference[..., ::-1])
    with ts.open([source.image], "gelslim", source="digit", reference=file) as opened:
        assert np.array_equal(opened[0].source.reference, source.reference)
    rest = ts.load_sensor("soft_bubble").rest_depth_mm
    np.save(tmp_path / "ref_m.npy", rest / 1000)
    depth = ts.depth(rest, tmp_path / "ref_m.npy", sensor="soft_bubble")
    assert not depth.contact.any()
    with pytest.raises(ts.TouchError, match=r"missing\.png"):
        ts.depth(source.image, tmp_path / "missing.png", sensor="digit")


@given(
    shape=st.lists(st.integers(0, 4), max_size=5),
    kind=st.sampled_from(["u1", "f4", "i8", "?", "U1"]),
)
def test_arrays_of_another_shape_or_type_are_refused(shape, kind):
    images = np.zeros(shape, kind)
    is_right = len(shape) == 4 and shape[-1] == 3 and images.size and kind == "u1"
    if not is_right:
        with pytest.raises(ShapeError, match="uint8"):
            ts.make_recording(images, None, ts.load_sensor("digit"))


@pytest.mark.parametrize(
    ("convert", "fact"),
    [
        (lambda mm: mm / 1000, "1000 times too small, so its unit is another one; give mm"),
        (lambda mm: np.nan_to_num(mm * 10).astype(np.uint16), "10 times too large"),
        (lambda mm: np.where(np.arange(mm.shape[1]) < 100, 0, mm / 1000), "1000 times too small"),
        (lambda mm: -mm, "negative depth; give the distance from the camera, positive"),
    ],
)
def test_depth_arrays_of_another_unit_or_sign_are_refused(convert, fact):
    rest = ts.load_sensor("soft_bubble").rest_depth_mm
    assert not ts.depth(rest, rest, sensor="soft_bubble").contact.any()
    for image, reference, what in (
        (convert(rest), convert(rest), "image 0"),
        (rest, convert(rest), "the reference"),
    ):
        with pytest.raises(ShapeError, match=f"{what} .*{fact}"):
            ts.depth(image, reference, sensor="soft_bubble")


def test_arrays_need_their_sensor_and_their_reference_fits(touches):
    images = [touches[TOUCHED].image]
    with pytest.raises(SettingProblem, match="give source"):
        ts.open(images, "gelslim")
    with pytest.raises(ts.TouchError, match=r"no reference image .*reference="):
        ts.depth(images[0], None, sensor="digit")
    with pytest.raises(ShapeError, match="the reference has shape"):
        ts.open(images, "gelslim", source="digit", reference=images[0][:10])
    with pytest.raises(ShapeError, match="several shapes"):
        ts.open([images[0], images[0][:10]], "gelslim", source="digit")
    with pytest.raises(ShapeError, match="one time an image"):
        ts.make_recording(images, None, ts.load_sensor("digit"), times_s=[0.0, 1.0])
    with pytest.raises(SettingProblem, match="the reference of a file is a file"):
        ts.open(SAMPLE, "gelslim", reference=images[0])


def test_a_frame_of_a_closed_recording_and_a_stage_without_membrane_are_sentences(touches):
    with ts.open(SAMPLE, "gelslim", source="digit") as opened:
        frame = opened[TOUCHED]
    for read in (lambda: frame.depth, lambda: frame.truth):
        with pytest.raises(ts.TouchError, match="the recording is closed; read its frames before"):
            read()
    with pytest.raises(
        SettingProblem, match="the membrane of 'touch' is not tracked; choose one of depth"
    ):
        ts.track(touches, "touch", [TOUCHED])


def test_a_training_needs_pairs_or_a_recipe(tmp_path):
    with pytest.raises(
        SettingProblem, match="nothing called 'magic' can be trained; there are depth"
    ):
        ts.train("magic", tmp_path)
    with pytest.raises(SettingProblem, match="give pairs to train t2t on, or a recipe: t2t_bubble"):
        ts.train("t2t", tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_mesh_is_a_file_of_any_unit_or_one_at_hand(touches, tmp_path):
    file = tmp_path / "box.obj"
    corners = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]])
    faces = ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    file.write_text("\n".join([*("v {} {} {}".format(*c) for c in corners), *faces]))
    with pytest.raises(ts.TouchError, match=r"0\.02 mm large"):
        ts.open(SAMPLE, "gelslim", source="digit", mesh=file)
    given = ts.load_mesh(file, unit="m")
    for mesh, unit in ((file, "m"), (given, "auto")):
        with ts.open(SAMPLE, "gelslim", source="digit", mesh=mesh, mesh_unit=unit) as opened:
            np.testing.assert_array_equal(opened.mesh.vertices_mm, given.vertices_mm)
            assert opened.symmetry is None
            assert any("symmetry is not known" in note for note in opened.notes)


def test_simulated_touches_have_their_truth_and_are_the_same_again():
    one, two = (
        ts.simulate("sphere", sensors, n=2, seed=3).stream() for sensors in (["digit"], "digit")
    )
    assert np.array_equal(one.frame(1).image, two.frame(1).image)
    assert one.truth(1).contact.any()
    with pytest.raises(SettingProblem, match="no sequence 'dance'"):
        ts.simulate("sphere", ["digit"], sequence="dance")
    with pytest.raises(SettingProblem, match="a group of"):
        ts.simulate("all", ["digit"])


def test_a_written_alignment_is_read_back(touches, tmp_path):
    shifted = np.array(touches.alignment.target_from_alignment)
    shifted[0, 3] += 1.5
    alignment = replace(touches.alignment, target_from_alignment=shifted)
    ts.save_alignment(touches.with_alignment(alignment), tmp_path / "a.toml")
    with ts.open(SAMPLE, "gelslim", source="digit", alignment=tmp_path / "a.toml") as opened:
        np.testing.assert_allclose(opened.alignment.target_from_alignment, shifted, atol=1e-9)


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (
            lambda _: ts.open(SAMPLE, "gelslim", source="digit", device="toaster"),
            "another (device=)",
        ),
        (lambda file: ts.open(file, "gelslim"), "source"),
        (lambda _: ts.simulate("sphere", "digit", n=0), "n must"),
        (lambda _: ts.simulate("sphere", "digit", seed=-1), "seed must"),
        (lambda _: ts.simulate("sphere", ["digit", "digit"]), "sensors must"),
        (
            lambda file: ts.train("t2t", file.parent, recipe="t2t_bubble", workers=-1),
            "workers must",
        ),
    ],
)
def test_errors_name_arguments_and_no_options(act, said, tmp_path):
    file = tmp_path / "touch.png"
    cv2.imwrite(str(file), np.full((50, 40, 3), 90, np.uint8))
    with pytest.raises(ts.TouchError) as caught:
        act(file)
    assert said in str(caught.value)
    assert "--" not in str(caught.value)
