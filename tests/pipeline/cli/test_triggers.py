"""What a user can get wrong on the command line: each is one sentence and exit code 2, and leaves
nothing behind.

A trigger prepares its files in a folder and returns the words that are typed. The folder is
compared before and after.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import torch

from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.sensors.descriptions import DESCRIPTIONS_FOLDER as SENSORS
from tests.pipeline.cli.conftest import dent, save

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
TRIGGERS = {}


def trigger(make):
    """Enter a trigger into the table under its name."""
    TRIGGERS[make.__name__] = make
    return make


def touched(here, *more, out=None):
    """Translate a folder of one touch."""
    folder = here / "touch"
    folder.mkdir(exist_ok=True)
    save(folder / "background.png", dent(0.0))
    save(folder / "touch.png", dent(0.5))
    return translated(folder, *more, out=out or here / "out")


def translated(recording, *more, out=None, sensor="gelsight_mini"):
    return (
        "translate",
        recording,
        "--target",
        "gelslim",
        "--sensor",
        sensor,
        "--out",
        out or recording.parent / "out",
        *more,
    )


def described(here, old, new, *, of="gelsight_mini"):
    """Inspect with a sensor of one's own, a copy whose text has `new` in the place of `old`."""
    text = (SENSORS / f"{of}.toml").read_text()
    assert old in text
    (here / "mine.toml").write_text(text.replace(old, new, 1))
    return asked_of(here, here / "mine.toml")


def asked_of(here, sensor):
    words = touched(here)
    return tuple(sensor if word == "gelsight_mini" else word for word in words)


def number_of(key, value, of="gelsight_mini"):
    """The line of a description that gives `key`, and that line with another value."""
    line = next(
        line
        for line in (SENSORS / f"{of}.toml").read_text().splitlines()
        if line.startswith(f"{key} ")
    )
    head, _, tail = line.partition("value = ")
    return line, f"{head}value = {value}{tail[tail.index(',') :]}"


def sample(here, change):
    """Inspect... a copy of the sample recording after `change` was made to it."""
    path = here / "changed.h5"
    shutil.copy(SAMPLE, path)
    with h5py.File(path, "r+") as file:
        change(file)
    return translated(path, "--all", sensor="gelslim")


def replaced(file, name, array):
    del file[name]
    file[name] = array


def depths(here, **arrays):
    np.savez(here / "depths.npz", **arrays)
    return translated(here / "depths.npz", "--all", sensor="soft_bubble")


def tensors(here, value):
    torch.save(value, here / "odd.pt")
    return translated(here / "odd.pt", sensor="soft_bubble")


# --- places for results


@trigger
def out_is_proc(here):
    return touched(here, out="/proc/results")


@trigger
def out_is_proc_itself(here):
    return touched(here, out="/proc")


@trigger
def out_is_a_file(here):
    (here / "out").write_text("mine")
    return touched(here)


@trigger
def out_is_below_a_file(here):
    (here / "file").write_text("mine")
    return touched(here, out=here / "file" / "out")


@trigger
def out_is_a_device(here):
    return touched(here, out="/dev/null")


@trigger
def out_is_a_loop_of_links(here):
    (here / "out").symlink_to(here / "back")
    (here / "back").symlink_to(here / "out")
    return touched(here)


@trigger
def out_has_a_name_too_long(here):
    return touched(here, out=here / ("o" * 300))


@trigger
def alignment_out_is_proc(here):
    return (
        "align",
        "refine",
        SAMPLE,
        "--target",
        "soft_bubble",
        "--frames",
        "2",
        "--out",
        "/proc/refined.toml",
    )


@trigger
def lookup_out_is_a_folder(here):
    touched(here)
    (here / "lookup.npz").mkdir()
    return balls(here)


@trigger
def lookup_out_is_proc(here):
    touched(here)
    return balls(here, out="/proc/lookup.npz")


@trigger
def simulated_out_is_proc(here):
    return simulated(here, "--poses", "2", out="/proc/made.h5")


@trigger
def simulated_out_is_below_a_file(here):
    (here / "file").write_text("mine")
    return simulated(here, "--poses", "2", out=here / "file" / "made.h5")


@trigger
def bench_json_is_a_folder(here):
    return ("bench", "graph", "--json", here)


@trigger
def bench_plots_is_a_file(here):
    (here / "plots").write_text("mine")
    return ("bench", "graph", "--plots", here / "plots")


def balls(here, *more, out=None, diameter="6.31"):
    return (
        "calibrate",
        "balls",
        here / "touch",
        "--sensor",
        "gelsight_mini",
        "--diameter-mm",
        diameter,
        "--reference",
        here / "touch" / "background.png",
        "--out",
        out or here / "lookup.npz",
        *more,
    )


def simulated(here, *more, tools="sphere_r6", out=None):
    return (
        "simulate",
        "--sensors",
        "gelslim",
        "--tools",
        tools,
        "--out",
        out or here / "made.h5",
        *more,
    )


# --- numbers


@trigger
def frame_below_zero(here):
    return touched(here, "--frame=-1")


@trigger
def frame_beyond_the_last(here):
    return touched(here, "--frame", "99999999999999999999")


@trigger
def frame_is_a_raised_two(here):
    return touched(here, "--frame", "²")


@trigger
def shifted_by_a_kilometre(here):
    return touched(here, "--translation-mm", "1e6", "0", "0")


@trigger
def shifted_by_nan(here):
    return touched(here, "--translation-mm", "nan", "0", "0")


@trigger
def turned_beyond_counting(here):
    return touched(here, "--rotation-deg", "0", "0", "1e20")


@trigger
def watched_for_nan_seconds(_here):
    return ["live", "--seconds", "nan"]


@trigger
def a_contender_that_does_not_exist(_here):
    return ["evaluate", "--split", "unseen_tools", "--only", "nosuch"]


@trigger
def frame_and_all(here):
    return touched(here, "--frame", "0", "--all")


def scored(frames):
    return (
        "align",
        "score",
        SAMPLE,
        "--target",
        "soft_bubble",
        "--sensor",
        "gelslim",
        "--frames",
        frames,
    )


@trigger
def frames_are_a_raised_two(here):
    return scored("²")


@trigger
def frames_go_on_for_ever(here):
    return scored("0-99999999999")


@trigger
def frames_go_backwards(here):
    return scored("5-1")


@trigger
def frames_have_five_thousand_digits(here):
    return scored("1" * 5000)


@trigger
def a_share_that_is_no_number(here):
    return (
        "align",
        "refine",
        SAMPLE,
        "--target",
        "soft_bubble",
        "--hold-out",
        "nan",
        "--out",
        here / "a.toml",
    )


@trigger
def a_tolerance_below_zero(here):
    return (
        "align",
        "refine",
        SAMPLE,
        "--target",
        "soft_bubble",
        "--tolerance=-1",
        "--out",
        here / "a.toml",
    )


@trigger
def a_setting_of_nan(here):
    return touched(here, "--set", "pose.iterations=nan")


@trigger
def a_setting_without_value(here):
    return touched(here, "--set", "project.mode")


@trigger
def a_ball_of_no_size(here):
    touched(here)
    return balls(here, diameter="nan")


@trigger
def a_ball_of_a_kilometre(here):
    touched(here)
    return balls(here, diameter="1e6")


@trigger
def a_pixel_of_infinite_width(here):
    touched(here)
    return balls(here, "--pixel-mm", "inf")


@trigger
def a_pattern_that_is_none(here):
    touched(here)
    return balls(here, "--pattern", "")


@trigger
def a_seed_below_zero(here):
    touched(here)
    return balls(here, "--seed=-1")


@trigger
def poses_beyond_counting(here):
    return simulated(here, "--poses", "999999999999")


@trigger
def no_poses(here):
    return simulated(here, "--poses", "0")


@trigger
def jobs_beyond_any_machine(here):
    return simulated(here, "--poses", "1", "--jobs", "1000000")


@trigger
def drag_of_nan(here):
    return simulated(here, "--poses", "1", "--drag-mm", "nan")


@trigger
def a_specimen_of_1e300(here):
    return simulated(here, "--poses", "1", "--vary", "1e300")


# --- names


@trigger
def an_unknown_command(here):
    return ("transalte", here)


@trigger
def an_unknown_option(here):
    return touched(here, "--colour", "red")


@trigger
def nothing_given(here):
    return ("translate",)


@trigger
def an_unknown_unit(here):
    return touched(here, "--depth-unit", "inch")


@trigger
def an_unknown_question(here):
    return ("bench", "meaning_of_life")


@trigger
def an_empty_name(here):
    return translated(Path(), out=here / "out")


@trigger
def a_name_that_is_no_text(here):
    path = here / os.fsdecode(b"touch\xff\x1b[31m.npz")
    path.write_bytes(b"nothing")
    return translated(path)


@trigger
def a_name_too_long(here):
    return translated(here / ("x" * 300))


# --- what stands where a recording belongs


@trigger
def a_recording_that_is_a_pipe(here):
    os.mkfifo(here / "pipe.h5")
    return translated(here / "pipe.h5")


@trigger
def a_recording_without_end(here):
    return translated(Path("/dev/zero"), out=here / "out")


@trigger
def a_recording_of_nothing(here):
    return translated(Path("/dev/null"), out=here / "out")


@trigger
def a_loop_of_links(here):
    (here / "a.h5").symlink_to(here / "b.h5")
    (here / "b.h5").symlink_to(here / "a.h5")
    return translated(here / "a.h5")


@trigger
def an_empty_file(here):
    (here / "empty.npz").touch()
    return translated(here / "empty.npz")


@trigger
def a_folder_named_as_a_file(here):
    (here / "folder.h5").mkdir()
    return translated(here / "folder.h5")


@trigger
def a_picture_that_is_a_folder(here):
    words = touched(here)
    (here / "touch" / "touch.png").unlink()
    (here / "touch" / "touch.png").mkdir()
    return words


@trigger
def a_picture_that_is_a_pipe(here):
    words = touched(here)
    (here / "touch" / "touch.png").unlink()
    os.mkfifo(here / "touch" / "touch.png")
    return words


@trigger
def a_video_that_is_text(here):
    (here / "touch.mp4").write_text("not a video")
    return translated(here / "touch.mp4")


@trigger
def a_picture_of_one_pixel(here):
    words = touched(here)
    cv2.imwrite(str(here / "touch" / "touch.png"), np.zeros((1, 1, 3), np.uint8))
    return words


# --- other files that are given


@trigger
def a_reference_that_is_a_folder(here):
    return touched(here, "--reference", here)


@trigger
def a_lookup_that_is_a_folder(here):
    return touched(here, "--calibration", here)


@trigger
def a_lookup_that_is_a_pipe(here):
    os.mkfifo(here / "lookup.npz")
    return touched(here, "--calibration", here / "lookup.npz")


@trigger
def a_lookup_of_other_arrays(here):
    np.savez(here / "lookup.npz", a=np.zeros(3))
    return touched(here, "--calibration", here / "lookup.npz")


@trigger
def a_lookup_that_would_be_unpickled(here):
    np.savez(here / "lookup.npz", **{"table": np.array([{"a": 1}], dtype=object)})
    return touched(here, "--calibration", here / "lookup.npz")


@trigger
def a_mesh_that_is_empty(here):
    (here / "tool.stl").touch()
    return touched(here, "--mesh", here / "tool.stl")


@trigger
def a_mesh_that_is_a_folder(here):
    return touched(here, "--mesh", here)


@trigger
def a_mesh_that_is_a_pipe(here):
    os.mkfifo(here / "tool.obj")
    return touched(here, "--mesh", here / "tool.obj")


@trigger
def a_mesh_of_nan(here):
    (here / "tool.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return touched(here, "--mesh", here / "tool.obj")


@trigger
def a_mesh_with_corners_that_are_not_there(here):
    (here / "tool.obj").write_text("v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 99\n")
    return touched(here, "--mesh", here / "tool.obj")


@trigger
def an_alignment_that_is_empty(here):
    (here / "a.toml").touch()
    return touched(here, "--alignment", here / "a.toml")


@trigger
def an_alignment_that_is_a_folder(here):
    (here / "a.toml").mkdir()
    return touched(here, "--alignment", here / "a.toml")


@trigger
def an_alignment_that_is_no_text(here):
    (here / "a.toml").write_bytes(b"\xff\xfe\x00source = 1")
    return touched(here, "--alignment", here / "a.toml")


# --- a sensor's description


@trigger
def a_description_without_three(here):
    (here / "mine.toml").write_text('extends = "gelslim"\nwithout = 3\n')
    return asked_of(here, here / "mine.toml")


@trigger
def a_description_nested_beyond_reason(here):
    (here / "mine.toml").write_text("a = " + "[" * 20_000 + "]" * 20_000)
    return asked_of(here, here / "mine.toml")


@trigger
def a_description_that_extends_itself(here):
    (here / "mine.toml").write_text(f'extends = "{here / "mine.toml"}"\n')
    return asked_of(here, here / "mine.toml")


@trigger
def a_description_that_is_no_text(here):
    (here / "mine.toml").write_bytes(b"\xff\xfe\xfa")
    return asked_of(here, here / "mine.toml")


@trigger
def a_description_that_is_a_folder(here):
    (here / "mine.toml").mkdir()
    return asked_of(here, here / "mine.toml")


@trigger
def a_description_that_is_a_pipe(here):
    os.mkfifo(here / "mine.toml")
    return asked_of(here, here / "mine.toml")


@trigger
def a_description_that_is_empty(here):
    (here / "mine.toml").touch()
    return asked_of(here, here / "mine.toml")


@trigger
def a_camera_of_one_row(here):
    return described(here, *number_of("rows", 1))


@trigger
def a_camera_that_sees_a_needle(here):
    return described(here, *number_of("fx", 1e9))


@trigger
def a_camera_of_1e300(here):
    return described(here, *number_of("fx", 1e300))


@trigger
def a_camera_of_nan(here):
    return described(here, *number_of("fy", "nan"))


@trigger
def a_number_that_is_a_list(here):
    return described(here, *number_of("cx", "[1, 2]"))


# --- arrays of another shape, type or content


@trigger
def frames_of_text(here):
    return sample(here, lambda f: replaced(f, "streams/gelslim/frames", np.array([b"a", b"b"])))


@trigger
def frames_of_one_axis(here):
    return sample(here, lambda f: replaced(f, "streams/gelslim/frames", np.zeros(7, np.uint8)))


@trigger
def a_reference_of_another_size(here):
    return sample(
        here, lambda f: replaced(f, "streams/gelslim/references", np.zeros((1, 3, 4, 3), np.uint8))
    )


@trigger
def no_streams(here):
    return sample(here, lambda f: f.pop("streams"))


@trigger
def depths_of_four_axes(here):
    return depths(here, depth_mm=np.zeros((2, 2, 3, 4)))


@trigger
def depths_of_words(here):
    return depths(here, depth_mm=np.array(["a", "b"]))


@trigger
def depths_of_nothing(here):
    return depths(here, depth_mm=np.zeros((0, 140, 175), np.float32))


@trigger
def depths_that_are_complex(here):
    return depths(here, depth_mm=np.full((3, 140, 175), 80 + 1j))


@trigger
def a_tensor_alone(here):
    return tensors(here, torch.zeros(3))


@trigger
def tensors_of_no_axes(here):
    return tensors(here, {"bubble_imprint": torch.tensor(1.0), "bubble_depth": torch.tensor(1.0)})


@trigger
def tensors_that_are_sparse(here):
    return tensors(here, {"bubble_depth": torch.zeros(2, 140, 175).to_sparse()})


@trigger
def tensors_of_bits(here):
    return tensors(here, {"bubble_depth": torch.zeros(2, 140, 175, dtype=torch.bool)})


@trigger
def tensors_in_a_list(here):
    return tensors(here, [1, "two", None])


@trigger
def a_recording_cut_short(here):
    cut = here / "cut.h5"
    cut.write_bytes(SAMPLE.read_bytes()[: SAMPLE.stat().st_size // 20])
    return translated(cut, "--frame", "5")


@pytest.mark.parametrize("name", TRIGGERS)
def test_a_mistake_is_one_sentence_and_leaves_nothing_behind(name, tmp_path, capfd, log):
    here = tmp_path / "here"
    here.mkdir()
    words = [str(word) for word in TRIGGERS[name](here)]
    before = contents(here)
    code = run_app(build_app(), words)
    said, err = capfd.readouterr()
    assert not log.exists(), log.read_text()
    assert code == EXIT_USER_ERROR, err
    lines = [line for line in err.splitlines() if line.strip()]
    assert len(lines) == 1, err
    assert lines[0].startswith("tactoscope: ")
    assert len(lines[0]) < 700
    assert "Traceback" not in said + err
    left = {name: size for name, size in contents(here).items() if before.get(name) != size}
    assert not {name for name in left if not name.endswith("report.json")}, (
        "something is left behind"
    )


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (
            ("translate", "REC", "--target", "digit", "--out", "OUT", "--scheduler", "x"),
            "translate --help'",
        ),
        (
            ("translate", "REC", "--target", "digit", "--out", "OUT.rrd"),
            "leave that out, or write one",
        ),
        (("task", "insertion", "--disturb", "slip=1,slip=2"), "slip more than once"),
        (("inspect", "OUT"), "no such file or folder: '"),
    ],
)
def test_a_mistake_names_its_remedy_once(words, remedy, tmp_path, capfd):
    places = {
        "REC": str(SAMPLE),
        "OUT": str(tmp_path / "out"),
        "OUT.rrd": str(tmp_path / "out.rrd"),
    }
    assert run_app(build_app(), [places.get(word, word) for word in words]) == EXIT_USER_ERROR
    assert remedy in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


def contents(folder):
    """Files below a folder and their sizes, without following what they link to."""
    return {
        str(p.relative_to(folder)): p.lstat().st_size for p in folder.rglob("*") if not p.is_dir()
    }
