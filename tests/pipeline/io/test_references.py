"""The median of a recording's untouched frames as its reference."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.core.errors import select_warnings
from pipeline.io.format_dispatch import open_recording
from pipeline.io.reference_images import denoise_reference
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from tests.pipeline.stages.test_depth import press

MINI = load_sensor("gelsight_mini")
STILL = optics.render_reference(MINI)


def noisy(image, seed, grey=3.0):
    noise = np.random.default_rng(seed).normal(0.0, grey, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def test_the_median_of_frames_without_contact_has_less_noise():
    found, n = denoise_reference(noisy(STILL, 0), (noisy(STILL, k) for k in range(1, 10)))
    assert n == 9
    off = [np.abs(image.astype(float) - STILL).mean() for image in (found, noisy(STILL, 0))]
    assert off[0] < 0.5 * off[1]


@pytest.mark.parametrize("depth_mm", [0.15, 0.5])
def test_frames_after_the_first_contact_are_not_averaged(depth_mm):
    _, touch, _ = press("gelsight_mini", depth_mm=depth_mm)
    frames = [noisy(STILL, 1), noisy(STILL, 2), touch.image, noisy(STILL, 3)]
    _, n = denoise_reference(noisy(STILL, 0), frames)
    assert n == 2


def test_a_single_frame_is_returned_unchanged():
    first = noisy(STILL, 0)
    found, n = denoise_reference(
        first, [noisy(STILL, 1), noisy(press("gelsight_mini")[1].image, 2)]
    )
    assert n == 0
    assert found is first


def test_a_folder_opens_with_the_averaged_reference(tmp_path):
    for name, image in (
        ("ref", noisy(STILL, 0)),
        *((f"{k}", noisy(STILL, k)) for k in range(1, 5)),
    ):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image[..., ::-1])
    recording = open_recording(tmp_path, sensor="gelsight_mini")
    assert any("first 4 frames" in note for note in recording.notes)
    reference = recording.streams[0].frame(0).reference
    assert (
        np.abs(reference.astype(float) - STILL).mean()
        < 0.6 * np.abs(noisy(STILL, 0).astype(float) - STILL).mean()
    )
    as_asked = open_recording(tmp_path, sensor="gelsight_mini", reference=tmp_path / "ref.png")
    assert np.array_equal(as_asked.streams[0].frame(0).reference, noisy(STILL, 0))


@pytest.fixture
def film(tmp_path):
    def made(*pictures):
        path = tmp_path / "touch.avi"
        writer = cv2.VideoWriter(
            str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, STILL.shape[1::-1]
        )
        for picture in pictures:
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
        writer.release()
        return path

    return made


@pytest.mark.parametrize("depth_mm", [0.15, 0.5])
def test_a_video_that_begins_with_contact_takes_a_later_frame_as_reference(film, depth_mm):
    _, touch, _ = press("gelsight_mini", depth_mm=depth_mm)
    recording = open_recording(
        film(*[touch.image] * 3, *[STILL] * 4, touch.image), sensor="gelsight_mini"
    )
    (warning,) = select_warnings(recording.notes)
    assert "frames 3 to 6" in warning
    assert "--reference" in warning
    assert np.abs(recording.streams[0].frame(0).reference.astype(float) - STILL).mean() < 3.0
    recording.close()


def test_a_video_that_begins_without_contact_keeps_its_first_frames_when_the_light_drifts(film):
    _, touch, _ = press("gelsight_mini", depth_mm=0.5)
    dim = np.rint(0.9 * STILL).astype(np.uint8)
    recording = open_recording(film(*[STILL] * 4, *[touch.image] * 2, dim), sensor="gelsight_mini")
    assert select_warnings(recording.notes) == ()
    assert any("the median of frame 0 to frame 3" in note for note in recording.notes)
    recording.close()


START = [np.zeros_like(STILL)] * 2 + [
    np.rint(STILL * gain).astype(np.uint8) for gain in (0.3, 0.6, 0.85)
]


OVEREXPOSED = [np.clip(STILL * 3.0, 0, 255).astype(np.uint8)] * 3


@pytest.mark.parametrize("dark", [START, START[:2], START[2:3] * 3, START[3:], OVEREXPOSED])
@pytest.mark.parametrize("is_film", [False, True])
def test_the_dark_frames_of_a_camera_that_starts_are_no_reference(
    film, tmp_path, dark, is_film: bool
):
    _, touch, _ = press("gelsight_mini", depth_mm=0.5)
    images = [*dark, *[STILL] * 4, *[touch.image] * 6]
    for index, image in enumerate(images):
        cv2.imwrite(
            str(tmp_path / f"frame_{index:03d}.png"), np.ascontiguousarray(image[..., ::-1])
        )
    recording = open_recording(film(*images) if is_film else tmp_path, sensor="gelsight_mini")
    reference = recording.streams[0].frame(0).reference
    assert np.abs(reference.astype(float) - STILL).mean() < 3.0
    (note,) = (note for note in recording.notes if "darker" in note)
    assert f"{len(dark)}.png to" in note.replace("frame_00", "") or f"frame {len(dark)} to" in note
    recording.close()


@pytest.mark.parametrize("gain", [1.15, 1.3])
def test_a_light_that_was_raised_later_leaves_the_first_frames_as_reference(film, gain):
    _, touch, _ = press("gelsight_mini", depth_mm=0.5)
    raised = np.clip(np.rint(touch.image * gain), 0, 255).astype(np.uint8)
    recording = open_recording(film(*[STILL] * 4, *[raised] * 8), sensor="gelsight_mini")
    assert np.abs(recording.streams[0].frame(0).reference.astype(float) - STILL).mean() < 3.0
    recording.close()
