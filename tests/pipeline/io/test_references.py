"""The median of a recording's untouched frames as its reference."""

from __future__ import annotations

from itertools import chain

import cv2
import numpy as np
import pytest

from pipeline.core.errors import StageWarning, select_warnings
from pipeline.io.format_dispatch import open_recording
from pipeline.io.reference_images import denoise_reference, find_first_reference
from pipeline.physics import gel, optics
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


def press_cloth(name, deep_mm=0.05, weave_mm=0.04):
    """(untouched, touched) images: a woven cloth on a soft pad, threads 1 mm apart."""
    source = load_sensor(name)
    y, x = np.indices(source.camera.shape) * source.pixel_mm
    x, y = x - x.mean(), y - y.mean()
    weave = np.sin(2 * np.pi * (x + y) / 1.4) * np.sin(2 * np.pi * (x - y) / 1.4)
    overlap = deep_mm + weave_mm * weave - deep_mm * (x**2 + y**2) / 8
    touch = gel.press_gel(source.gel, source.pixel_mm, overlap, tolerance_mm=2e-3)
    return optics.render_reference(source), optics.render(source, touch.indentation_mm, seed=None)


def find_reference(images):
    frames = [noisy(image, k, 1.0) for k, image in enumerate(images)]
    return find_first_reference(
        lambda index: frames[index], len(frames), lambda index: f"frame {index}", is_film=True
    )


CLOTH = pytest.mark.parametrize("name", ["gelslim", "gelslim_dotless", "gelsight_mini", "digit"])


@CLOTH
def test_a_film_that_begins_on_cloth_takes_a_later_frame_as_reference(name: str):
    still, touch = press_cloth(name)
    reference, note = find_reference([*[touch] * 8, *[still] * 5, *[touch] * 3])
    assert isinstance(note, StageWarning)
    assert "first frame shows contact" in note
    assert np.abs(reference.astype(float) - still).mean() < 0.9


@CLOTH
@pytest.mark.parametrize("n_untouched", [1, 4])
def test_cloth_that_comes_later_leaves_the_first_frames_as_reference(name: str, n_untouched: int):
    still, touch = press_cloth(name, 0.005, 0.015)
    images = [*[still] * n_untouched, *[touch] * 12]
    reference, note = find_reference(images)
    assert not isinstance(note, StageWarning)
    expected, _ = denoise_reference(
        noisy(still, 0, 1.0), (noisy(still, k, 1.0) for k in range(1, n_untouched))
    )
    assert np.array_equal(reference, expected)


@pytest.mark.parametrize("is_reversed", [False, True])
def test_frames_that_differ_by_what_may_be_light_are_warned_of(film, is_reversed: bool):
    ramp = np.linspace(-14, 14, STILL.shape[1])[:, None]
    later = np.clip(np.rint(STILL + ramp), 0, 255).astype(np.uint8)
    images = [*[STILL] * 5, *[later] * 5][:: -1 if is_reversed else 1]
    path = film(*images)
    with_warning = open_recording(path, sensor="gelsight_mini")
    (warning,) = select_warnings(with_warning.notes)
    assert "none clearly has more contact" in warning
    assert "--reference-frames" in warning
    with_warning.close()
    chosen = open_recording(path, sensor="gelsight_mini", reference_frames="0")
    assert select_warnings(chosen.notes) == ()
    chosen.close()


def test_a_film_in_which_nothing_happens_is_not_warned_of():
    assert not isinstance(find_reference([STILL] * 20)[1], StageWarning)


def read_things(folder):
    images = [folder / "ref.jpg", *sorted(folder.glob("frame_*.jpg"))]
    return [cv2.imread(str(image))[..., ::-1] for image in images]


@pytest.mark.parametrize("is_touched", [False, True])
def test_everyday_things_are_told_from_the_untouched_gel(real_data, is_touched: bool):
    for folder in sorted((real_data / "mini_things").iterdir()):
        still, *_, touch = read_things(folder)
        images = [[touch] * 6, [still] * 6][:: 1 if is_touched else -1]
        reference, note = find_reference(chain.from_iterable(images))
        assert isinstance(note, StageWarning) == is_touched, folder.name
        assert np.abs(reference.astype(float) - still).mean() < 0.9, folder.name
