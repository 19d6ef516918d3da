"""A reference image made of a recording's own touches."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.base.errors import FileProblem, TouchError
from pipeline.cli.main import build_app, run_app
from pipeline.recordings.image_files import read_rgb
from pipeline.recordings.reference_estimate import write_reference

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
