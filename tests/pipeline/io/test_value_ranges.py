"""What the numbers of stored images mean, whatever a few of them are.

And where they cannot be told.
"""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.io import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.views.preview import DisplayParams, make_frame_preview

NOISE = np.random.default_rng(0)
ROUNDING_GREY = 1
STORED = {  # name -> how images are stored, and the grey levels that may be lost
    "unit": (lambda x: x / 255, ROUNDING_GREY),
    "unit with noise": (lambda x: x / 255 + NOISE.normal(0, 0.01, x.shape), 16),
    "half floats": (lambda x: (x / 255).astype(np.float16), ROUNDING_GREY),
    "one value above 1": (
        lambda x: np.where(np.arange(x.size).reshape(x.shape) == 7, 3.0, x / 255),
        255,
    ),
    "one value below 0": (
        lambda x: np.where(np.arange(x.size).reshape(x.shape) == 7, -0.4, x / 255),
        255,
    ),
    "overshoot": (lambda x: x / 255 * 1.05 - 0.025, 8),
    "signed unit": (lambda x: x / 127.5 - 1, ROUNDING_GREY),
    "signed unit with noise": (lambda x: x / 127.5 - 1 + NOISE.normal(0, 0.01, x.shape), 9),
    "grey floats": (lambda x: x.astype(np.float64), 0),
    "grey with noise": (lambda x: x + NOISE.normal(0, 2, x.shape), 12),
    "whole numbers": (lambda x: x.astype(np.int32), 0),
    "bytes": (lambda x: x, 0),
}


@pytest.mark.parametrize("how", STORED)
@pytest.mark.parametrize("has_reference", [False, True])
def test_images_are_read_as_they_were(tmp_path: Path, touches, how: str, has_reference: bool):
    store, lost_grey = STORED[how]
    arrays = {
        "frames": touches.images,
        **({"reference": touches.reference} if has_reference else {}),
    }
    np.savez(tmp_path / "a.npz", **{key: store(a) for key, a in arrays.items()})
    recording = open_recording(tmp_path / "a.npz")
    frame = recording.streams[0].frame(8)
    assert np.abs(frame.image.astype(int) - touches.images[8]).max() <= lost_grey
    assert np.abs(frame.image.astype(float) - touches.images[8]).mean() < 3.0
    # also of the first, untouched frames
    assert np.abs(frame.reference.astype(float) - touches.reference).mean() < 4.0
    assert frame.stored_image is None


@pytest.mark.parametrize("white", [1.0, 255.0])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_a_difference_has_its_mode_at_no_change_and_is_shown_as_stored(
    tmp_path: Path, touches, white, dtype
):
    if dtype is np.int16 and white == 1.0:
        pytest.skip("whole numbers are grey levels")
    change = touches.images.astype(float) - touches.reference
    np.save(tmp_path / "a.npy", (change / 255 * white).astype(dtype))
    recording = open_recording(tmp_path / "a.npy")
    assert any("0 is no change" in note for note in recording.notes)
    frame = recording.streams[0].frame(8)
    assert np.abs(frame.shown_image.astype(float) - (128 + change[8])).mean() < 1.0
    spec = load_sensor("gelslim")
    shown = make_frame_preview(
        frame.shown_image, spec.camera, spec, DisplayParams(), reference=frame.reference
    )
    assert np.array_equal(shown.pixels, frame.stored_image)
    # which is what depth is computed from
    assert not np.array_equal(frame.image, frame.stored_image)


@pytest.mark.parametrize(
    "store",
    [
        lambda x: x / 255 - 0.5,
        lambda x: (x / 255 - 0.45) / 0.225,
        lambda x: (x - x.mean()) / x.std(),
        lambda x: x.astype(float) - 128,
        lambda x: x.astype(np.uint16) * 257,
        lambda x: x / 255 * 4095,
        lambda x: x / 100,
        lambda x: (x.astype(int) - 128).astype(np.int8),
    ],
)
def test_numbers_that_may_mean_several_things_are_refused_with_a_remedy_that_works(
    tmp_path: Path, touches, store
):
    np.save(tmp_path / "a.npy", store(touches.images))
    with pytest.raises(FileProblem, match=r"must hold grey levels.*save images as uint8"):
        open_recording(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", touches.images)
    assert open_recording(tmp_path / "a.npy").streams[0].sensor == "gelslim"


def test_a_value_that_is_not_finite_is_named_by_its_frame(tmp_path: Path, touches):
    images = (touches.images / 255).astype(np.float32)
    images[9, 3, 3] = np.nan
    np.save(tmp_path / "a.npy", images)
    with pytest.raises(FileProblem, match="not finite"):
        open_recording(tmp_path / "a.npy").streams[0].frame(9)


@pytest.mark.parametrize(
    "place",
    [
        lambda x: x[None],
        lambda x: x[:, None],
        lambda x: x.transpose(0, 3, 1, 2),
        lambda x: x[None].transpose(0, 1, 4, 2, 3),
        lambda x: np.concatenate([x, np.full_like(x[..., :1], 255)], axis=3),
    ],
)
def test_axes_of_length_one_channels_first_and_opacity_do_not_matter(
    tmp_path: Path, touches, place
):
    np.save(tmp_path / "a.npy", place(touches.images))
    (stream,) = open_recording(tmp_path / "a.npy").streams
    assert stream.n_frames == len(touches.images)
    assert np.array_equal(stream.frame(8).image, touches.images[8])


@pytest.mark.parametrize(
    "join",
    [
        lambda a, b: np.stack([a, b], axis=1),
        lambda a, b: np.stack([a, b]),
        lambda a, b: np.concatenate([a, b], axis=3),
        lambda a, b: np.concatenate([a, b], axis=3).transpose(0, 3, 1, 2),
    ],
)
def test_two_fingers_in_one_array_are_two_streams(tmp_path: Path, touches, join):
    other = touches.images[::-1]
    np.savez(tmp_path / "a.npz", tactile=join(touches.images, other))
    one, two = open_recording(tmp_path / "a.npz").streams
    assert (one.name, two.name) == ("gelslim_0", "gelslim_1")
    assert np.array_equal(one.frame(8).image, touches.images[8])
    assert np.array_equal(two.frame(8).image, other[8])


@pytest.mark.parametrize("grey", [lambda x: x, lambda x: x[..., None], lambda x: x > 100])
@pytest.mark.parametrize("name", ["frames", "depth_mm"])
def test_grey_arrays_are_no_depth_whatever_unit_is_given(tmp_path: Path, touches, grey, name: str):
    np.savez(tmp_path / "a.npz", **{name: grey(touches.images.mean(axis=3).astype(np.uint8))})
    for unit in ("auto", "mm", "m"):
        with pytest.raises(FileProblem, match="grey images"):
            open_recording(tmp_path / "a.npz", depth_unit=unit)


def test_grey_images_are_refused_and_say_what_to_do(tmp_path: Path, touches):
    for i, image in enumerate(touches.images):
        cv2.imwrite(str(tmp_path / f"{i}.png"), cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    with pytest.raises(FileProblem, match=r"are grey.*in colour"):
        open_recording(tmp_path)


@pytest.mark.parametrize("kind", ["colour", "depth"])
def test_one_array_a_frame_is_one_recording(tmp_path: Path, touches, kind: str):
    for i, image in enumerate([touches.reference, *touches.images]):
        depth = np.where(image[..., 0] > 128, 80.0, 75.0)
        np.save(
            tmp_path / f"{'touch' if kind == 'colour' else 'depth'}_{i}_mm.npy",
            image if kind == "colour" else depth,
        )
    (stream,) = open_recording(tmp_path).streams
    assert stream.n_frames == 1 + len(touches.images)
    frame = stream.frame(9)  # the tenth, after the ninth and not after the first
    assert frame.reference is not None
    assert np.array_equal(frame.image, touches.images[8]) if kind == "colour" else frame.is_depth


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.zeros((40, 50, 3), np.float32), "multiply by 255"),
        (np.zeros((40, 50, 3), np.uint16), "divide by 257"),
        (np.full((140, 175), 80, np.float32), "cannot tell the unit"),
    ],
)
def test_images_of_floats_and_16_bits_say_what_they_are(tmp_path: Path, image, why: str):
    cv2.imwrite(str(tmp_path / "a.tiff"), image)
    with pytest.raises(FileProblem, match=why):
        open_recording(tmp_path / "a.tiff")
    if image.ndim == 2:
        assert (
            open_recording(tmp_path / "a.tiff", depth_unit="mm").streams[0].frame(0).image[0, 0]
            == 80.0
        )


@pytest.mark.parametrize(
    ("folder", "step_mm"), [("touch", 0.1), ("touch", 1.0), ("0.1mm", 0.1), ("mm", 1.0)]
)
def test_the_unit_of_a_depth_folder_is_its_name_or_the_one_that_the_message_names(
    tmp_path, folder, step_mm
):
    """What fits the membrane is named, and works when it is given."""
    (tmp_path / folder).mkdir()
    for i in range(3):
        image = np.full((140, 175), round(75.4 / step_mm), np.uint16)
        assert cv2.imwrite(str(tmp_path / folder / f"{i}.png"), image)
    unit = "auto"
    if folder == "touch":
        with pytest.raises(FileProblem, match="cannot tell the unit of 'touch'") as caught:
            open_recording(tmp_path / folder)
        unit = re.search(
            r"give --depth-unit (\S+), which fits the membrane of soft_bubble", str(caught.value)
        )[1]
    frame = open_recording(tmp_path / folder, depth_unit=unit).stream().frame(0)
    assert frame.image == pytest.approx(75.4, abs=0.5)


def test_a_reference_is_of_the_sensor_of_an_array_that_the_user_names(tmp_path, touches):
    np.savez(tmp_path / "a.npz", tactile=np.stack([touches.images, touches.images[::-1]], axis=1))
    reference = tmp_path / "r.png"
    assert cv2.imwrite(str(reference), np.full_like(touches.images[0], 77))
    with pytest.raises(SettingProblem, match="choose one with --stream, by the name"):
        open_recording(tmp_path / "a.npz", reference=reference)
    first, second = open_recording(
        tmp_path / "a.npz", reference=reference, stream="gelslim_1"
    ).streams
    assert (second.frame(0).reference == 77).all()
    assert not (first.frame(0).reference == 77).all()
