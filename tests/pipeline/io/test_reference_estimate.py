"""A reference image made of a recording's own touches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.cli.main import build_app, run_app
from pipeline.core.errors import FileProblem, TouchError
from pipeline.io import open_recording
from pipeline.io.image_files import read_rgb
from pipeline.io.mounts import mount, unmount
from pipeline.io.reference_estimate import write_reference

SAMPLE_RECORDING = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
SHAPE = (240, 320, 3)


def draw_presses(n: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """The untouched image and presses of a disc at different places, with noise."""
    rng = np.random.default_rng(0)
    still = np.broadcast_to(np.linspace(60, 170, SHAPE[1])[None, :, None], SHAPE)
    presses = []
    for _ in range(n):
        image = (still + rng.normal(0, 1.5, SHAPE)).round().astype(np.uint8)
        at = int(rng.integers(40, 280)), int(rng.integers(40, 200))
        presses.append(cv2.circle(image, at, 30, (230, 40, 90), -1))
    return still, presses


def write_images(folder, images):
    folder.mkdir()
    for index, image in enumerate(images):
        cv2.imwrite(str(folder / f"press_{index}.png"), image[:, :, ::-1])


def test_presses_vanish_from_the_median(tmp_path, capsys):
    still, presses = draw_presses(25)
    write_images(tmp_path / "a", presses)
    out = tmp_path / "reference.png"
    run_app(
        build_app(), ["inspect", str(tmp_path / "a"), "--make-reference", str(out)]
    )  # its checks are not of a real gel
    assert np.abs(read_rgb(out) - still).max() < 4
    said = capsys.readouterr().out
    assert "median of 25 images" in said
    assert "reference.png is the reference" in said


def test_damaged_images_are_left_out_of_the_median(tmp_path):
    still, presses = draw_presses(25)
    write_images(tmp_path / "a", presses)
    for index in (0, 7):
        (tmp_path / "a" / f"press_{index}.png").write_bytes(b"not an image")
    made, n_images = write_reference(tmp_path / "a", tmp_path / "new.png")
    assert n_images == 23
    assert np.abs(made - still).max() < 4


def test_a_bad_reference_in_the_folder_does_not_count(tmp_path):
    still, presses = draw_presses(25)
    write_images(tmp_path / "a", presses)
    cv2.imwrite(str(tmp_path / "a" / "reference.png"), np.zeros(SHAPE, np.uint8))
    made, n_images = write_reference(tmp_path / "a", tmp_path / "new.png")
    assert n_images == 25
    assert np.abs(made - still).max() < 4


@pytest.mark.parametrize("out", ["a/press_0.png", "reference.txt"])
def test_no_input_is_replaced_and_the_output_is_an_image(tmp_path, out):
    _, presses = draw_presses(5)
    write_images(tmp_path / "a", presses)
    before = (tmp_path / "a" / "press_0.png").read_bytes()
    with pytest.raises(TouchError):
        write_reference(tmp_path / "a", tmp_path / out)
    assert (tmp_path / "a" / "press_0.png").read_bytes() == before


def test_a_missing_recording_is_named(tmp_path):
    with pytest.raises(FileProblem, match=r"cannot read the recording \(No such file.*MISSING"):
        write_reference(tmp_path / "MISSING", tmp_path / "r.png")


def test_too_few_images_are_refused(tmp_path):
    write_images(tmp_path / "a", draw_presses(2)[1])
    with pytest.raises(TouchError, match="3 images"):
        write_reference(tmp_path / "a", tmp_path / "r.png")


def test_a_median_between_two_grey_levels_is_rounded(tmp_path):
    for index, grey in enumerate((11, 11, 12, 12)):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((4, 5, 3), grey, np.uint8))
    image, n = write_reference(tmp_path, tmp_path / "out" / "reference.png")
    assert n == 4
    assert (image == 12).all()


@pytest.fixture(scope="module")
def gel_folder(tmp_path_factory):
    """A GelSlim in mid-touch at first, then untouched, with the noise of a camera.

    (folder, untouched image).
    """
    frame = open_recording(SAMPLE_RECORDING).stream("gelslim").frame(0)
    touch = max(
        (open_recording(SAMPLE_RECORDING).stream("gelslim").frame(i) for i in range(16)),
        key=lambda f: np.abs(f.image.astype(int) - f.reference).sum(),
    )
    rng = np.random.default_rng(0)
    folder = tmp_path_factory.mktemp("gel")
    for index, image in enumerate([touch.image] * 3 + [frame.reference] * 9):
        noisy = (image + rng.normal(0, 1.0, image.shape)).clip(0, 255).round().astype(np.uint8)
        cv2.imwrite(str(folder / f"frame_{index:02d}.png"), noisy[..., ::-1])
    return folder, frame.reference


@pytest.mark.parametrize(
    ("frames", "note"),
    [
        (
            "median",
            "the median of 12 frames is the reference; check that it shows no touch, as chosen",
        ),
        ("untouched", "the median of 9 frames with least contact is the reference, as chosen"),
        ("11", "frame 11 is the reference, as chosen"),
        ("3", "frame 3, as the median with the 8 alike ones after it, is the reference, as chosen"),
    ],
)
def test_a_reference_is_made_of_the_recordings_own_frames(gel_folder, frames, note):
    folder, untouched = gel_folder
    recording = open_recording(folder, sensor="gelslim", reference_frames=frames)
    assert recording.notes[-1] == note
    reference = recording.stream().frame(0).reference
    spread = 3.0 if frames == "11" else 1.0
    assert np.abs(reference.astype(int) - untouched).mean() < spread
    assert all(recording.stream().frame(i).reference is reference for i in (0, 7)), (
        "one array, so one estimate"
    )


def test_a_reference_of_depth_frames_is_their_median_in_mm():
    recording = open_recording(SAMPLE_RECORDING, stream="soft_bubble", reference_frames="median")
    stream = recording.stream("soft_bubble")
    stack = np.stack([stream.frame(i).image for i in range(stream.n_frames)])
    assert stream.frame(0).reference.dtype == np.float32
    np.testing.assert_allclose(stream.frame(0).reference, np.nanmedian(stack, axis=0), rtol=1e-6)
    assert recording.stream("gelslim").frame(0).reference.dtype == np.uint8, (
        "of another sensor, as recorded"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reference_frames": "99"}, "a frame from 0 to 11, got '99'"),
        ({"reference_frames": "-1"}, "got '-1'"),
        ({"reference_frames": "mean"}, "'median', of 'untouched' frames or of a frame"),
        (
            {"reference_frames": "0", "reference": "frame_00.png"},
            "either a file or made of the recording's frames",
        ),
    ],
)
def test_other_references_are_refused(gel_folder, options, words):
    folder, _ = gel_folder
    if "reference" in options:
        options = {**options, "reference": folder / options["reference"]}
    with pytest.raises(TouchError, match=words):
        open_recording(folder, sensor="gelslim", **options)


def test_a_recording_that_grows_keeps_the_reference_that_was_chosen(gel_folder):
    grown = open_recording(gel_folder[0], sensor="gelslim")
    path = gel_folder[0] / "live"
    mount(path, lambda: replace(grown, path=path, refresh=lambda: grown))
    chosen = open_recording(path, reference_frames="11")
    unmount(path)
    assert chosen.refresh().stream().frame(0).reference is chosen.stream().frame(0).reference


def test_a_bundle_holds_the_frame_with_the_reference_that_was_chosen(tmp_path, gel_folder):
    folder, untouched = gel_folder
    options = [
        "--sensor",
        "gelslim",
        "--target",
        "soft_bubble",
        "--method",
        "depth=physics",
        "--frame",
        "5",
    ]
    out = tmp_path / "a.bundle"
    assert not run_app(
        build_app(),
        ["bundle", str(folder), *options, "--reference-frames", "11", "--out", str(out)],
    )
    (file,) = out.rglob("frame.h5")
    assert (
        np.abs(open_recording(file).stream().frame(0).reference.astype(int) - untouched).mean()
        < 3.0
    )
    assert not run_app(build_app(), ["replay", str(out)])


def test_a_note_that_no_reference_was_found_goes_where_one_is_chosen(tmp_path):
    image = open_recording(SAMPLE_RECORDING).stream("gelslim").frame(0).image
    cv2.imwrite(str(tmp_path / "touch.png"), image[..., ::-1])
    (note,) = [n for n in open_recording(tmp_path, sensor="gelslim").notes if "reference" in n]
    assert "no reference image was found" in note
    (note,) = [
        n
        for n in open_recording(tmp_path, sensor="gelslim", reference_frames="0").notes
        if "reference" in n
    ]
    assert note == "frame 0 is the reference, as chosen"
