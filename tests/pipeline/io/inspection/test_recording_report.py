"""The report of a recording, and the checks that find what is wrong with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipeline.core.errors import FileProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import Pairing, Stream, TactileFrame, Truth
from pipeline.io import open_recording
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.io.inspection.recording_report import (
    InspectionReport,
    format_report_lines,
    inspect_recording,
)
from pipeline.io.inspection.stream_checks import StreamChecker
from pipeline.physics.optics import render_reference
from pipeline.sensors.spec import load_sensor

GEL = load_sensor("digit")
BUBBLE = load_sensor("soft_bubble")
DENT = np.zeros(GEL.camera.shape, np.float32)
DENT[100:140, 80:120] = 0.5
TRUTH = Truth(
    indentation_mm=DENT, contact=DENT > 0.2, sensor_from_object=rigid.from_parts((0.0, 0.0, 22.0))
)


def gel(index: int, image=None, **changes) -> TactileFrame:
    picture = render_reference(GEL) if image is None else image
    values = {
        "sensor": "digit",
        "image": picture,
        "reference": picture,
        "index": index,
        "time_s": 0.05 * index,
    }
    return TactileFrame(**{**values, **changes})


def bubble(index: int, sign: float = 1.0) -> TactileFrame:
    rest = BUBBLE.rest_depth_mm.astype(np.float32)
    depth = rest.copy()
    depth[60:90, 60:90] -= np.float32(sign * 5.0)
    return TactileFrame(sensor="soft_bubble", image=depth, reference=rest, index=index)


def record(path: Path, frames, truths=(), **options) -> Path:
    with RecordingWriter(path, **options) as writer:
        for k, frame in enumerate(frames):
            writer.append(frame.sensor, frame, truths[k] if k < len(truths) else None)
    return path


def state(report: InspectionReport, name: str) -> tuple[str, str]:
    found = next(c for c in report.checks if c.name.endswith(name))
    return found.state, found.text


def test_a_lost_frame_does_not_change_the_rate(tmp_path: Path):
    report = inspect_recording(record(tmp_path / "a.h5", [gel(i) for i in (0, 1, 2, 4, 5)]))
    assert (report.streams[0].duration_s, report.streams[0].rate_hz) == pytest.approx((0.25, 20.0))


@pytest.mark.parametrize(("unit", "n"), [("ms", 1e3), ("µs", 1e6), ("ns", 1e9)])
def test_times_in_another_unit_are_named(tmp_path: Path, unit: str, n: float):
    start = 1_744_664_892.0
    frames = [gel(i, time_s=(start + i / 30.0) * n) for i in range(6)]
    found = state(inspect_recording(record(tmp_path / "a.h5", frames)), "times")
    assert found[0] == "fail"
    assert f"30 Hz if they are in {unit}" in found[1]
    # by a robot, at its pace
    presses = [gel(i, time_s=t) for i, t in enumerate((0.0, 21.0, 37.0, 72.0, 90.0, 121.0))]
    assert state(inspect_recording(record(tmp_path / "b.h5", presses)), "times")[0] == "unknown"


def test_streams_that_lost_frames_or_share_no_time_are_named(tmp_path: Path):
    frames = [gel(i) for i in range(8)]
    lost = [replace(bubble(i), time_s=0.05 * i) for i in range(8) if i not in (2, 5)]
    found = state(
        inspect_recording(record(tmp_path / "a.h5", frames + lost)), "digit with soft_bubble"
    )
    assert found[0] == "unknown"
    assert (
        "6 frames of digit and soft_bubble are paired by their times; 2 of digit have no partner"
        in found[1]
    )
    later = [replace(bubble(i), time_s=1e6 + 0.05 * i) for i in range(8)]
    found = state(
        inspect_recording(record(tmp_path / "b.h5", frames + later)), "digit with soft_bubble"
    )
    assert found[0] == "fail"
    assert "check their clocks" in found[1]


def test_inspection_reads_each_frame_of_many_streams_once(tmp_path: Path, monkeypatch):
    path = tmp_path / "a.h5"
    n = 12
    with RecordingWriter(path) as writer:
        for stream in range(n):
            for index in range(3):
                writer.append(f"finger_{stream}", gel(index))
    opened = open_recording(path)
    reads: list[str] = []

    def count(stream):
        def frame(index):
            reads.append(stream.name)
            return stream.frame(index)

        return replace(stream, frame=frame)

    counted = replace(opened, streams=tuple(map(count, opened.streams)))
    monkeypatch.setattr(
        "pipeline.io.inspection.recording_report.open_recording", lambda *_, **__: counted
    )
    inspect_recording(path)
    assert len(reads) == 3 * n


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_depth_off_by_ten_is_noticed_and_another_camera_is_not(tmp_path: Path, factor: float):
    def scaled(by):
        frame = bubble(0)
        image, reference = (np.float32(by) * a for a in (frame.image, frame.reference))
        return state(
            inspect_recording(
                record(tmp_path / f"{by}.h5", [replace(frame, image=image, reference=reference)])
            ),
            "unit",
        )

    assert scaled(factor)[0] == "fail"
    assert "10 times too" in scaled(factor)[1]
    assert scaled(1.5)[0] == scaled(1 / 1.5)[0] == "pass"


def test_a_good_recording_passes_and_is_described(tmp_path: Path):
    frames = [gel(i) for i in range(5)] + [bubble(i) for i in range(5)]
    pair = Pairing(
        source="digit", target="soft_bubble", target_from_source=rigid.from_parts((0, 0, 54.0))
    )
    report = inspect_recording(record(tmp_path / "a.h5", frames, [TRUTH] * 5, pairings=[pair]))
    assert report.has_passed
    assert {c.state for c in report.checks} <= {"pass", "unknown"}
    digit = report.streams[0]
    assert (digit.sensor, digit.n_frames, digit.rows, digit.cols) == ("digit", 5, 320, 240)
    assert digit.truth == ("contact", "indentation_mm", "sensor_from_object")
    assert (digit.duration_s, digit.rate_hz) == (pytest.approx(0.2), pytest.approx(20.0))
    text = "\n".join(format_report_lines(report))
    assert "digit: digit, 5 frames, 240 x 320 px uint8 RGB, 0.20 s at 20.0 Hz" in text
    assert [stream.dtype for stream in report.streams] == ["uint8 RGB", "float32 depth in mm"]
    assert "FAIL" not in text
    for name in (
        "frames",
        "image size",
        "reference",
        "colours",
        "depth unit",
        "depth sign",
        "truth",
        "poses",
    ):
        assert state(report, name)[0] == "pass", name
    assert state(report, "digit to soft_bubble")[0] == "pass"


def test_one_damaged_frame_is_listed_and_the_others_are_counted(tmp_path: Path):
    path = record(tmp_path / "a.h5", [gel(i) for i in range(4)])
    data = bytearray(path.read_bytes())
    with h5py.File(path, "r") as f:
        data[f["streams/digit/frames"].id.get_chunk_info(2).byte_offset + 50] ^= 1
    path.write_bytes(data)
    report = inspect_recording(path)
    assert report.streams[0].n_frames == 4
    assert not report.has_passed
    check = state(report, "frames")
    assert check[0] == "fail"
    assert "frame 2 of 'digit': its frames are damaged" in check[1]
    assert "a.h5" in check[1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p[:, :, ::-1], "red and blue look swapped"),
        (lambda p: p[:, ::-1], "mirrored"),
        (lambda p: p[::-1, ::-1], "rotated by 180"),
        (lambda p: p.mean(axis=2, keepdims=True) + 0 * p, "no colours"),
        (
            lambda p: np.rot90(render_reference(load_sensor("gelsight_mini"))),
            "it looks like one of gelsight_mini rotated by 90 degrees",
        ),
    ],
)
def test_changed_colours_are_noticed(tmp_path: Path, change, words: str):
    picture = np.ascontiguousarray(change(render_reference(GEL)).astype(np.uint8))
    found = state(inspect_recording(record(tmp_path / "a.h5", [gel(0, picture)])), "colours")
    assert found[0] == "fail"
    assert words in found[1]


def test_swapped_colours_of_real_images_are_noticed(real_data: Path, tmp_path: Path):
    assert state(inspect_recording(real_data / "digit_balls"), "colours")[0] == "pass"
    for name in ("background.png", "0000.png"):
        swapped = cv2.imread(str(real_data / "digit_balls" / name))[:, :, ::-1]
        cv2.imwrite(str(tmp_path / name), swapped)
    assert state(inspect_recording(tmp_path), "colours")[0] == "fail"


def test_a_flipped_depth_sign_is_noticed(tmp_path: Path):
    report = inspect_recording(record(tmp_path / "a.h5", [bubble(0, sign=-1.0)]))
    assert state(report, "depth sign")[0] == "fail"


def test_depth_in_metres_is_noticed(tmp_path: Path):
    metres = (BUBBLE.rest_depth_mm / 1000.0).astype(np.float32)
    frame = TactileFrame(sensor="soft_bubble", image=metres, reference=metres)
    found = state(inspect_recording(record(tmp_path / "a.h5", [frame])), "depth unit")
    assert found[0] == "fail"
    assert "0.08 mm" in found[1] or "0.07" in found[1]


def test_depth_with_many_gaps_is_noticed(tmp_path: Path):
    frame = bubble(0)
    image = frame.image.copy()
    image[:100] = np.nan
    frame = TactileFrame(sensor="soft_bubble", image=image, reference=frame.reference)
    assert state(inspect_recording(record(tmp_path / "a.h5", [frame])), "gaps")[0] == "fail"


def test_times_that_go_back_are_noticed(tmp_path: Path):
    found = state(
        inspect_recording(record(tmp_path / "a.h5", [gel(0), gel(1, time_s=-1.0)])), "times"
    )
    assert found[0] == "fail"
    assert "do not rise after frame 0" in found[1]


@pytest.mark.parametrize(
    ("truth", "name", "words"),
    [
        (Truth(indentation_mm=DENT, contact=DENT < 0.2), "truth", "contact of frame 0"),
        (Truth(indentation_mm=DENT * 6.2), "truth", "reaches 3.1 mm, the limit is 1.5 mm"),
        (
            Truth(indentation_mm=np.full_like(DENT, np.nan)),
            "truth",
            "indentation_mm of frame 0 has no value",
        ),
        (Truth(sensor_from_object=np.diag([1.0, 1.0, -1.0, 1.0])), "poses", "mirrors space"),
        (Truth(sensor_from_object=rigid.from_parts((0, 0, 22000.0))), "poses", "2.2e"),
    ],
)
def test_truth_that_contradicts_itself_is_noticed(
    tmp_path: Path, truth: Truth, name: str, words: str
):
    found = state(inspect_recording(record(tmp_path / "a.h5", [gel(0)], [truth])), name)
    assert found[0] == "fail"
    assert words in found[1]


def test_contact_of_a_gel_that_bulges_into_a_hollow_object_passes(tmp_path: Path):
    hollow = np.where(np.indices(DENT.shape)[1] % 8 == 0, np.float32(-0.1), DENT) * (DENT > 0)
    touched = Truth(indentation_mm=hollow.astype(np.float32), contact=DENT > 0.2)
    assert (
        state(inspect_recording(record(tmp_path / "a.h5", [gel(0)], [touched])), "truth")[0]
        == "pass"
    )
    turned = Truth(indentation_mm=-DENT, contact=DENT > 0.2)
    assert (
        state(inspect_recording(record(tmp_path / "b.h5", [gel(0)], [turned])), "truth")[0]
        == "fail"
    )


def test_truth_beyond_twice_the_limit_fails_and_further_frames_are_counted(tmp_path: Path):
    # 2.9 mm and 3.1 mm, the limit 1.5
    deep = [Truth(indentation_mm=DENT * times) for times in (5.8, 6.2, 6.2, 6.2)]
    assert (
        state(inspect_recording(record(tmp_path / "a.h5", [gel(0)], deep[:1])), "truth")[0]
        == "pass"
    )
    found = state(
        inspect_recording(record(tmp_path / "b.h5", [gel(i) for i in range(4)], deep)), "truth"
    )
    assert found[0] == "fail"
    assert "of frame 1 reaches 3.1 mm" in found[1]
    assert "(and 2 more)" in found[1]


def test_another_image_size_and_a_missing_reference_are_noticed(tmp_path: Path):
    picture = np.zeros((100, 80, 3), np.uint8)
    report = inspect_recording(
        record(tmp_path / "a.h5", [gel(0, picture), gel(1, picture, reference=None)])
    )
    assert "frame 0 does not have the size of digit" in state(report, "image size")[1]
    assert "frame 1 has no reference" in state(report, "reference")[1]


def test_checks_that_cannot_be_made_are_unknown(tmp_path: Path):
    cv2.imwrite(
        str(tmp_path / "a.png"),
        np.random.default_rng(0).integers(0, 255, (50, 60, 3), dtype=np.uint8),
    )
    report = inspect_recording(tmp_path)
    assert report.has_passed
    assert {state(report, n)[0] for n in ("image size", "reference", "colours", "times")} == {
        "unknown"
    }
    assert any("unknown sensor" in line for line in format_report_lines(report))


def test_a_recording_that_cannot_be_opened_raises(tmp_path: Path):
    with pytest.raises(FileProblem, match="no such file"):
        inspect_recording(tmp_path / "nothing.h5")


def test_the_real_bubble_passes(real_data: Path):
    assert inspect_recording(real_data / "punyo_bubble" / "depth_sequence.npz").has_passed


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.full((*GEL.camera.shape, 3), 255, np.uint8), "frame 0 is 255 everywhere"),
        (np.zeros((*GEL.camera.shape, 3), np.uint8), "frame 0 is 0 everywhere"),
        (
            np.where(np.arange(320)[:, None, None] < 200, 255, render_reference(GEL)).astype(
                np.uint8
            ),
            "saturated: 62% of it",
        ),
    ],
)
def test_images_that_show_nothing_are_noticed(tmp_path: Path, image: np.ndarray, words: str):
    found = state(
        inspect_recording(
            record(tmp_path / "a.h5", [gel(0, image, reference=render_reference(GEL))])
        ),
        "images",
    )
    assert found[0] == "fail"
    assert words in found[1]


def test_depth_without_any_value_is_noticed(tmp_path: Path):
    nothing = np.full(BUBBLE.camera.shape, np.nan, np.float32)
    frame = TactileFrame(
        sensor="soft_bubble", image=nothing, reference=BUBBLE.rest_depth_mm.astype(np.float32)
    )
    found = state(inspect_recording(record(tmp_path / "a.h5", [frame])), "images")
    assert found == ("fail", f"frame 0 has no value at all: '{tmp_path / 'a.h5'}'")


@pytest.mark.parametrize("kind", [np.float64, np.uint16, np.int8, np.bool_])
def test_frames_of_another_type_are_noticed(tmp_path: Path, kind: type):
    picture = render_reference(GEL).astype(kind)
    stream = Stream(name="digit", sensor="digit", n_frames=1, frame=lambda _: gel(0, picture))
    checker = StreamChecker("digit", "a.h5", GEL)
    checker.add_frame(stream.frame(0))
    (types,) = (check for check in checker.summarize_checks([0.0]) if check.name == "digit types")
    assert types.state == "fail"
    assert f"frame 0 holds {np.dtype(kind)}, it must be uint8" in types.text


CUBE = np.array([[x, y, z] for x in (0.0, 9.0) for y in (0.0, 9.0) for z in (0.0, 9.0)])
SIDES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
WHOLE = np.concatenate([SIDES[:, [0, 1, 2]], SIDES[:, [0, 2, 3]]]).astype(np.int32)


@pytest.mark.parametrize(
    ("vertices", "triangles", "name", "words"),
    [
        (CUBE, WHOLE, "surface", "closed and facing outward, 729 mm³"),
        (CUBE, WHOLE[1:], "surface", "3 of its edges have no neighbour"),
        (CUBE, WHOLE[:, ::-1], "surface", "its triangles face inward (volume -729 mm³)"),
        (CUBE, np.concatenate([WHOLE, WHOLE[:1]]), "surface", "3 of its edges occur twice"),
        (CUBE / 1000.0, WHOLE, "size", "the mesh is 0.009 x 0.009 x 0.009 mm"),
        (CUBE * 100.0, WHOLE, "size", "the mesh is 900 x 900 x 900 mm"),
    ],
)
def test_the_mesh_of_the_object_is_checked(
    tmp_path: Path, vertices, triangles, name: str, words: str
):
    mesh = Mesh(
        vertices_mm=vertices, triangles=np.ascontiguousarray(triangles, np.int32), name="cube"
    )
    found = state(
        inspect_recording(record(tmp_path / "a.h5", [gel(0)], object_mesh=mesh)), f"object {name}"
    )
    assert words in found[1]
    assert (found[0] == "pass") == words.startswith("closed")


def test_a_sensor_of_a_users_file_is_checked_with_its_description(tmp_path: Path):
    path = record(tmp_path / "a.h5", [gel(0, sensor="mine")])
    (tmp_path / "mine.toml").write_text('extends = "digit"\n')
    assert state(inspect_recording(path), "image size")[0] == "unknown"
    assert (
        state(inspect_recording(path, sensor=str(tmp_path / "mine.toml")), "image size")[0]
        == "pass"
    )


def test_an_object_away_from_its_contact_is_noticed(tmp_path: Path):
    low = np.full(3, -4.0)
    high = np.array([4.0, 4.0, 0.5])
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    box = Mesh(vertices_mm=corners, triangles=np.array([[0, 1, 2], [3, 4, 5], [5, 6, 7]], np.int32))
    centre = (GEL.camera.back_project(GEL.rest_depth_mm)[120, 100]).astype(float)
    for at_mm, expected in ((centre, "pass"), (centre / 1000.0, "fail")):
        truth = Truth(
            indentation_mm=DENT, contact=DENT > 0.2, sensor_from_object=rigid.from_parts(at_mm)
        )
        path = record(tmp_path / f"{expected}.h5", [gel(0)], [truth], object_mesh=box)
        found = state(inspect_recording(path), "digit poses")
        assert found[0] == expected
    assert "from its contact" in found[1]
