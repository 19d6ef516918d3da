"""Pictures and depth of the right sensor at another size, differences, and pictures kept as
arrays.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, select_warnings
from pipeline.io import open_recording
from pipeline.io.inspection.recording_report import inspect_recording
from pipeline.io.resampling import infer_depth_camera
from pipeline.physics.optics import compute_colour_change, render_reference
from pipeline.sensors.parts import compute_reference_light
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth

GREY = 3.0  # levels by which a picture that was enlarged and reduced may differ


def smooth(shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng(1)
    return cv2.resize(
        rng.integers(40, 200, (8, 8, 3), dtype=np.uint8), shape[::-1], interpolation=cv2.INTER_CUBIC
    )


def save(path: Path, rgb: np.ndarray) -> None:
    assert cv2.imwrite(str(path), np.ascontiguousarray(rgb[..., ::-1]))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("digit", (640, 480)),
        ("gelsight_mini", (480, 640)),
        ("gelslim", (640, 854)),
        ("gelslim", (128, 128)),
    ],
)
def test_another_size_of_the_same_sensor_is_resampled_with_a_note(
    tmp_path: Path, name: str, shape: tuple[int, int]
):
    own = smooth(load_sensor(name).camera.shape)
    save(tmp_path / "press.png", cv2.resize(own, shape[::-1], interpolation=cv2.INTER_AREA))
    save(tmp_path / "ref.png", cv2.resize(own, shape[::-1], interpolation=cv2.INTER_AREA))
    recording = open_recording(tmp_path, sensor=name)
    frame = recording.streams[0].frame(0)
    assert frame.image.shape == frame.reference.shape == own.shape
    assert np.abs(frame.image.astype(float) - own).mean() < GREY
    (note,) = [n for n in recording.notes if "resampled" in n]
    is_tile = shape[0] == shape[1]  # a squeezed image has no millimetres
    assert ("have no millimetres" if is_tile else f"{load_sensor(name).pixel_mm:.4f} mm") in note
    assert not [
        c
        for c in inspect_recording(tmp_path, sensor=name).checks
        if c.name.endswith("image size") and c.state != "pass"
    ]


def test_a_digit_image_on_its_side_is_rotated_as_by_its_driver(tmp_path: Path):
    upright = smooth((320, 240))
    raw = np.flipud(upright).transpose(1, 0, 2)  # the driver transposes, then flips
    save(tmp_path / "press.png", cv2.resize(np.ascontiguousarray(raw), (640, 480)))
    recording = open_recording(tmp_path, sensor="digit")
    assert np.abs(recording.streams[0].frame(0).image.astype(float) - upright).mean() < GREY
    assert any("90 degrees" in note for note in recording.notes)


def test_the_full_image_of_a_mini_is_cropped_as_by_its_driver(tmp_path: Path):
    whole = np.full((2464, 3280, 3), (250, 240, 230), np.uint8)
    whole[352:2112, 469:2811] = (90, 60, 30)
    save(tmp_path / "press.png", whole)
    recording = open_recording(tmp_path)
    image = recording.streams[0].frame(0).image
    assert recording.streams[0].sensor == "gelsight_mini"
    assert image.shape == (240, 320, 3)
    assert image.max() == 90


def test_vga_may_be_of_two_sensors_and_is_not_guessed(tmp_path: Path):
    save(tmp_path / "press.png", smooth((480, 640)))
    recording = open_recording(tmp_path)
    assert recording.streams[0].sensor == ""
    assert any("may be gelsight_mini, or digit" in note for note in recording.notes)


def test_an_image_of_another_aspect_ratio_is_not_resampled(tmp_path: Path):
    save(tmp_path / "press.png", smooth((200, 400)))
    assert open_recording(tmp_path, sensor="digit").streams[0].frame(0).image.shape == (200, 400, 3)


@pytest.mark.parametrize(
    ("shape", "focal_px"), [((480, 640), 434.0), ((171, 224), 186.4), ((280, 350), 372.8)]
)
def test_depth_at_another_size_gets_a_camera_that_fits(
    tmp_path: Path, shape: tuple[int, int], focal_px: float
):
    folder = tmp_path / "depth_0p1mm"
    folder.mkdir()
    for k in range(8):
        counts = np.full(shape, 800 - 60 * (k == 7), np.uint16)
        cv2.imwrite(str(folder / f"{k}.png"), counts)
    frame = open_recording(folder).streams[0].frame(7)
    assert frame.camera.shape == shape
    assert frame.camera.fx_px == pytest.approx(focal_px)
    found = estimate_depth(frame, load_sensor("soft_bubble"), None, DepthParams())
    assert found.indentation_mm.shape == shape
    assert float(np.nanmedian(found.indentation_mm)) == pytest.approx(6.0, abs=0.5)


def test_one_sixteen_bit_image_is_depth_with_a_unit_and_a_reference(tmp_path: Path):
    cv2.imwrite(str(tmp_path / "touch.png"), np.full((140, 175), 770, np.uint16))
    cv2.imwrite(str(tmp_path / "rest_0p1mm.png"), np.full((140, 175), 800, np.uint16))
    with pytest.raises(FileProblem, match="cannot tell the unit of 'touch'"):
        open_recording(tmp_path / "touch.png")
    frame = (
        open_recording(
            tmp_path / "touch.png", depth_unit="0.1mm", reference=tmp_path / "rest_0p1mm.png"
        )
        .streams[0]
        .frame(0)
    )
    assert (frame.image[3, 3], frame.reference[3, 3]) == (77.0, 80.0)
    alone = open_recording(tmp_path / "touch.png", depth_unit="0.1mm")
    assert alone.streams[0].frame(0).reference is None
    assert any("name one with --reference" in note for note in alone.notes)
    assert (
        inspect_recording(tmp_path / "touch.png", depth_unit="0.1mm").streams[0].dtype
        == "float32 depth in mm"
    )


def test_a_depth_folder_finds_its_reference_image(tmp_path: Path):
    folder = tmp_path / "depth_mm"
    folder.mkdir()
    for name, mm in (("ref", 80), ("0", 70), ("1", 70)):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((140, 175), mm, np.uint16))
    frame = open_recording(folder).streams[0].frame(0)
    assert (frame.image[3, 3], frame.reference[3, 3]) == (70.0, 80.0)


def bump(spec) -> np.ndarray:
    """The change of colour of a dome pressed in, in grey levels."""
    row, col = np.indices(spec.camera.shape)
    r_sq = (row - spec.camera.rows / 2) ** 2 + (col - spec.camera.cols / 2) ** 2
    height = 0.5 * np.exp(-r_sq / (2 * 25.0**2))
    gy, gx = np.gradient(height, spec.pixel_mm)
    return compute_colour_change(spec, gx.astype(np.float32), gy.astype(np.float32))


@pytest.mark.parametrize("kept", ["mid-grey", "floats", "shares"])
def test_a_difference_implies_its_reference_and_has_the_depth_of_the_touch(
    tmp_path: Path, kept: str
):
    spec = load_sensor("gelsight_mini")
    change = bump(spec)
    match kept:
        case "mid-grey":
            path = tmp_path / "press.png"
            save(path, np.clip(np.rint(change + 128), 0, 255).astype(np.uint8))
        case "floats":
            np.save(path := tmp_path / "press.npy", change)
        case _:
            np.save(path := tmp_path / "press.npy", (change / 255.0).transpose(2, 0, 1)[None])
    recording = open_recording(path, sensor="gelsight_mini")
    assert any("differences from a reference" in note for note in recording.notes)
    found = estimate_depth(recording.streams[0].frame(0), spec, None, DepthParams())
    light = compute_reference_light(spec.camera, spec.optics)
    np.savez(
        tmp_path / "whole.npz",
        frames=np.clip(np.rint(light + change), 0, 255).astype(np.uint8)[None],
        reference=np.clip(np.rint(light), 0, 255).astype(np.uint8),
    )
    whole = estimate_depth(
        open_recording(tmp_path / "whole.npz").streams[0].frame(0), spec, None, DepthParams()
    )
    assert whole.indentation_mm.max() > 0.3
    assert found.indentation_mm.max() == pytest.approx(whole.indentation_mm.max(), rel=0.03)


def test_a_gel_without_contact_is_no_difference_image(tmp_path: Path):
    for name in ("digit", "gelsight_mini", "gelslim"):
        save(tmp_path / "press.png", render_reference(load_sensor(name)))
        assert open_recording(tmp_path / "press.png").streams[0].frame(0).reference is None


def test_colour_arrays_open_as_images(tmp_path: Path):
    frames = np.stack([np.full((320, 240, 3), 60 + k, np.uint8) for k in range(3)])
    np.save(tmp_path / "frames.npy", frames)
    stream = open_recording(tmp_path / "frames.npy").streams[0]
    assert (stream.n_frames, stream.sensor) == (3, "digit")
    np.testing.assert_array_equal(stream.frame(2).image, frames[2])
    np.savez(tmp_path / "touch.npz", image=frames[1].astype(np.float32) / 255, background=frames[0])
    frame = open_recording(tmp_path / "touch.npz").streams[0].frame(0)
    np.testing.assert_array_equal(frame.image, frames[1])
    np.testing.assert_array_equal(frame.reference, frames[0])


def test_colour_arrays_above_white_or_of_two_stacks_are_refused(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.full((320, 240, 3), 4000, np.uint16))
    with pytest.raises(FileProblem, match="must hold grey levels"):
        open_recording(tmp_path / "a.npy")
    two = np.zeros((320, 240, 3), np.uint8)
    np.savez(tmp_path / "b.npz", left=two, right=two)
    with pytest.raises(FileProblem, match=r"cannot tell which array holds the frames.*left.*right"):
        open_recording(tmp_path / "b.npz")


def uncropped(image, size: tuple[int, int], border: tuple[int, int, int]):
    """The full camera image (cols, rows) of a Mini whose driver crops a seventh at each side to
    `image`.
    """
    inner = cv2.resize(image, (size[0] * 5 // 7, size[1] * 5 // 7))
    y = (size[1] - inner.shape[0]) // 2
    x = (size[0] - inner.shape[1]) // 2
    rest = {"bottom": size[1] - inner.shape[0] - y, "right": size[0] - inner.shape[1] - x}
    return cv2.copyMakeBorder(
        inner, y, rest["bottom"], x, rest["right"], cv2.BORDER_CONSTANT, value=border
    )


@pytest.mark.parametrize("size", [(640, 480), (1640, 1232), (800, 600)])
@pytest.mark.parametrize("border", [(8, 12, 8), (20, 70, 25), None])
def test_the_vignette_tells_whether_an_image_of_a_mini_is_cropped(tmp_path: Path, size, border):
    still = render_reference(load_sensor("gelsight_mini"))
    save(
        tmp_path / "press.png",
        cv2.resize(still, size) if border is None else uncropped(still, size, border),
    )
    recording = open_recording(tmp_path, sensor="gelsight_mini")
    assert any(
        ("the full camera image" if border else "they are cropped") in note
        for note in recording.notes
    )
    assert np.abs(recording.streams[0].frame(0).image.astype(float) - still).mean() < 3.0


def test_a_vignette_that_does_not_tell_is_asked_about(tmp_path: Path):
    flat = np.random.default_rng(0).integers(60, 120, (480, 640, 3), dtype=np.uint8)
    save(tmp_path / "press.png", flat)
    (warning,) = select_warnings(open_recording(tmp_path, sensor="gelsight_mini").notes)
    assert "29 % too small" in warning
    assert "crop a seventh" in warning


@pytest.mark.parametrize(
    ("shape", "focal_px"), [((480, 848), 434.0), ((240, 424), 217.0), ((720, 1280), 651.0)]
)
def test_the_focal_length_of_a_stereo_camera_grows_with_its_image(
    shape: tuple[int, int], focal_px: float
):
    camera, (note,) = infer_depth_camera(load_sensor("soft_bubble"), shape)
    assert camera is not None
    assert (camera.shape, camera.fx_px, camera.fy_px) == (shape, focal_px, focal_px)
    assert (camera.cx_px, camera.cy_px) == ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
    assert f"about {focal_px:.0f} px" in note
