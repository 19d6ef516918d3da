"""Recordings of other projects' containers: MCAP topics, LeRobot data sets, TacQuad touches."""

from __future__ import annotations

import json
from contextlib import closing

import cv2
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, SettingProblem, StageWarning
from pipeline.io import open_recording
from pipeline.io.formats import describe_formats, make_dialog_filter

SHAPE = (240, 320, 3)  # of a GelSight Mini


def draw_frames(n: int, seed: int = 0) -> list[np.ndarray]:
    """Images that begin untouched, smooth so that codecs keep them."""
    ramp = np.linspace(60, 160, SHAPE[1])[None, :, None] * np.array([1.0, 0.8, 0.6]) + seed
    still = np.broadcast_to(ramp, SHAPE).astype(np.uint8)
    frames = []
    for index in range(n):
        frame = still.copy()
        if index > n // 2:
            cv2.circle(frame, (160, 120), 20 + index, (220, 40, 90), -1)
        frames.append(frame)
    return frames


def encode(frame: np.ndarray) -> bytes:
    return cv2.imencode(".png", frame[:, :, ::-1])[1].tobytes()


def write_mcap(path, frames, *, as_json=False):
    if as_json:
        import base64

        from mcap.writer import Writer

        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
            channel = writer.register_channel("/left/tactile", "json", schema)
            for index, frame in enumerate(frames):
                data = json.dumps(
                    {"format": "png", "data": base64.b64encode(encode(frame)).decode()}
                ).encode()
                writer.add_message(channel, log_time=index * 10**8, data=data, publish_time=0)
            writer.finish()
        return
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
    from mcap_protobuf.writer import Writer as ProtobufWriter

    with path.open("wb") as file:
        writer = ProtobufWriter(file)
        for index, frame in enumerate(frames):
            raw = RawImage(
                width=frame.shape[1],
                height=frame.shape[0],
                encoding="bgr8",
                step=3 * frame.shape[1],
                data=frame[:, :, ::-1].tobytes(),
            )
            writer.write_message("/gelsight_mini/image", raw, index * 10**8, index * 10**8)
            depth = RawImage(width=2, height=2, encoding="32FC1", step=8, data=bytes(16))
            writer.write_message("/depth", depth, index * 10**8, index * 10**8)
        writer.finish()


def test_topics_of_ros_2_are_streams(tmp_path):
    from mcap_ros2.writer import Writer

    path = tmp_path / "a.mcap"
    frames = draw_frames(5)
    header = "builtin_interfaces/Time stamp\nstring frame_id\n"
    stamp = "int32 sec\nuint32 nanosec\n"
    line = "=" * 80 + "\n"
    definition = (
        "std_msgs/Header header\nstring format\nuint8[] data\n"
        f"{line}MSG: std_msgs/Header\n{header}{line}MSG: builtin_interfaces/Time\n{stamp}"
    )
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/CompressedImage", definition)
        for index, frame in enumerate(frames):
            message = {
                "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
                "format": "png",
                "data": encode(frame),
            }
            writer.write_message("/digit", schema, message, log_time=index * 10**8, publish_time=0)
        writer.finish()
    recording = open_recording(path)
    (stream,) = recording.streams
    np.testing.assert_array_equal(stream.frame(4).image, frames[4])
    recording.close()


@pytest.mark.parametrize("as_json", [False, True])
def test_mcap_topics_are_streams(tmp_path, as_json):
    pytest.importorskip("mcap_protobuf")
    path = tmp_path / "a.mcap"
    frames = draw_frames(8)
    write_mcap(path, frames, as_json=as_json)
    recording = open_recording(path)
    (stream,) = recording.streams
    assert (stream.sensor, stream.n_frames) == ("gelsight_mini", 8)
    for index in (7, 0, 5):
        frame = stream.frame(index)
        np.testing.assert_array_equal(frame.image, frames[index])
        assert frame.time_s == pytest.approx(0.1 * index)
    np.testing.assert_array_equal(stream.frame(7).reference, frames[0])
    assert as_json == (not any("depth" in note for note in recording.notes))
    recording.close()


def test_an_mcap_without_a_first_frame_is_named_once(tmp_path, monkeypatch):
    path = tmp_path / "a.mcap"
    monkeypatch.setitem(globals(), "encode", lambda _: b"no image")
    write_mcap(path, draw_frames(1), as_json=True)
    with pytest.raises(FileProblem, match=r"^frame 0 cannot be decoded: '[^']*a\.mcap'$"):
        open_recording(path)


def test_a_damaged_mcap_is_refused(tmp_path):
    pytest.importorskip("mcap_protobuf")
    path = tmp_path / "a.mcap"
    write_mcap(path, draw_frames(4))
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    n_refused = 0
    frames = draw_frames(4)
    chunk = 17 + int.from_bytes(content[9:17], "little")  # after the header
    end = chunk + 9 + int.from_bytes(content[chunk + 1 : chunk + 9], "little")
    n_hits = 0
    for _ in range(60):
        spoilt = bytearray(content)
        at = int(rng.integers(len(spoilt)))
        n_left = int(rng.integers(1, len(spoilt)))
        spoilt[at] ^= 0xFF
        path.write_bytes(bytes(spoilt[:n_left]))
        # the chunk holds the topic and all its images
        n_hits += n_left < end or chunk + 25 <= at < end
        try:
            with closing(open_recording(path)) as recording:
                assert recording.streams[0].n_frames == 4
                for index in range(4):  # what opens is right
                    np.testing.assert_array_equal(
                        recording.streams[0].frame(index).image, frames[index]
                    )
        except FileProblem:
            n_refused += 1
    # the few others hit the head of the file or the list of topics
    assert n_hits <= n_refused <= n_hits + 5
    assert 20 < n_hits < 55


def write_lerobot(folder, cameras, n):
    (folder / "meta").mkdir(parents=True)
    info = {
        "codebase_version": "v3.0",
        "fps": 20,
        "total_episodes": 2,
        "total_frames": n,
        "features": {name: {"dtype": kind, "shape": SHAPE} for name, kind in cameras.items()}
        | {"action": {"dtype": "float32"}},
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info))


def test_lerobot_videos_follow_each_other(tmp_path):
    write_lerobot(
        tmp_path / "set",
        {"observation.images.tactile_left": "video", "observation.images.top": "video"},
        12,
    )
    frames = draw_frames(12)
    for k in range(2):
        place = tmp_path / "set" / "videos" / "observation.images.tactile_left" / "chunk-000"
        place.mkdir(parents=True, exist_ok=True)
        writer = cv2.VideoWriter(
            str(place / f"file-00{k}.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 20, (320, 240)
        )
        for frame in frames[6 * k : 6 * k + 6]:
            writer.write(np.ascontiguousarray(frame[:, :, ::-1]))
        writer.release()
    recording = open_recording(tmp_path / "set")
    (stream,) = recording.streams
    assert (stream.name, stream.sensor, stream.n_frames) == (
        "observation.images.tactile_left",
        "gelsight_mini",
        12,
    )
    for index in (11, 2, 6):
        image = stream.frame(index).image.astype(float)
        assert np.abs(image - frames[index]).mean() < 6
        assert stream.frame(index).time_s == pytest.approx(index / 20)
    assert any("observation.images.top" in note for note in recording.notes)
    recording.close()


TACTILE = "observation.images.tactile_left"


def write_episodes(folder, lengths, starts, *, version=3):
    """The table of episodes, which lie from these times on in the first file of the camera."""
    rows = [
        {
            "episode_index": k,
            "length": n,
            f"videos/{TACTILE}/chunk_index": 0,
            f"videos/{TACTILE}/file_index": 0,
            f"videos/{TACTILE}/from_timestamp": start,
        }
        for k, (n, start) in enumerate(zip(lengths, starts, strict=True))
    ]
    if version == 2:
        (folder / "meta" / "episodes.jsonl").write_text(
            "".join(json.dumps(row) + "\n" for row in rows)
        )
        return
    parquet = pytest.importorskip("pyarrow.parquet")
    place = folder / "meta" / "episodes" / "chunk-000"
    place.mkdir(parents=True)
    import pyarrow

    parquet.write_table(pyarrow.Table.from_pylist(rows), place / "file-000.parquet")


def write_video(path, frames):
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 20, (320, 240))
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[:, :, ::-1]))
    writer.release()


@pytest.mark.parametrize(
    ("lengths", "starts", "wanted"),
    [
        ([5], [0.4], range(8, 13)),  # an episode before it was deleted
        ([3, 4], [0.1, 0.45], [2, 3, 4, 9, 10, 11, 12]),  # one between them was
        ([4, 3], [0.4, 0.0], [8, 9, 10, 11, 0, 1, 2]),  # they were written in another order
    ],
)
def test_lerobot_episodes_lie_where_their_table_says(tmp_path, lengths, starts, wanted):
    folder = tmp_path / "set"
    write_lerobot(folder, {TACTILE: "video"}, sum(lengths))
    levels = [np.full(SHAPE, 40 + 8 * k, np.uint8) for k in range(16)]
    write_video(folder / "videos" / TACTILE / "chunk-000" / "file-000.mp4", levels)
    write_episodes(folder, lengths, starts)
    with closing(open_recording(folder)) as recording:
        stream = recording.stream(TACTILE)
        found = [
            round((float(stream.frame(k).image.mean()) - 40) / 8) for k in range(stream.n_frames)
        ]
    assert found == list(wanted)
    (folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(FileProblem, match="table of episodes cannot be read"):
        open_recording(folder)


def test_lerobot_episodes_of_version_2_are_found_by_number(tmp_path):
    """The second file is longer than its episode, and a frame that a file lacks is named when it
    is read.
    """
    folder = tmp_path / "set"
    write_lerobot(folder, {TACTILE: "video"}, 9)
    for k, n in enumerate((4, 7, 2)):
        frames = [np.full(SHAPE, 40 + 80 * k + 10 * i, np.uint8) for i in range(n)]
        write_video(folder / "videos" / "chunk-000" / TACTILE / f"episode_{k:06d}.mp4", frames)
    write_episodes(folder, [4, 2, 3], [0.0] * 3, version=2)
    lines = [
        json.loads(line) for line in (folder / "meta" / "episodes.jsonl").read_text().splitlines()
    ]
    plain = [{key: row[key] for key in ("episode_index", "length")} for row in lines]
    (folder / "meta" / "episodes.jsonl").write_text(
        "".join(json.dumps(row) + "\n" for row in plain)
    )
    with closing(open_recording(folder)) as recording:
        stream = recording.stream(TACTILE)
        found = [float(stream.frame(k).image.mean()) for k in range(8)]
        assert stream.n_frames == 9
        with pytest.raises(FileProblem, match="frame 8"):
            stream.frame(8)
    assert found == pytest.approx([40, 50, 60, 70, 120, 130, 200, 210], abs=4)


def test_lerobot_images_in_tables(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    name = "observation.images.digit_thumb"
    frames = draw_frames(7)
    write_lerobot(tmp_path / "set", {name: "image"}, 7)
    place = tmp_path / "set" / "data" / "chunk-000"
    place.mkdir(parents=True)
    table = pyarrow.table(
        {name: [{"bytes": encode(f), "path": None} for f in frames], "frame_index": list(range(7))}
    )
    parquet.write_table(table, place / "file-000.parquet", row_group_size=3)
    (stream,) = open_recording(tmp_path / "set").streams
    assert stream.n_frames == 7
    for index in (6, 0, 3):
        np.testing.assert_array_equal(stream.frame(index).image, frames[index])
    (place / "file-000.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(FileProblem, match="table"):
        open_recording(tmp_path / "set")


def test_a_wrong_lerobot_description_is_one_sentence(tmp_path):
    write_lerobot(tmp_path / "set", {"observation.images.touch": "video"}, 3)
    with pytest.raises(FileProblem, match="lacks the videos"):
        open_recording(tmp_path / "set")
    (tmp_path / "set" / "meta" / "info.json").write_text('{"fps": "many", "features": {}}')
    with pytest.raises(FileProblem, match="fps"):
        open_recording(tmp_path / "set")


def test_missing_packages_are_named(tmp_path, monkeypatch):
    import sys

    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(40))
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    with pytest.raises(SettingProblem, match="pip install"):
        open_recording(path)


def test_tacquad_touches_pair_their_sensors(tmp_path):
    touch = tmp_path / "tacquad" / "data_indoor" / "apple_0"
    frames = {
        "gelsight": draw_frames(12),
        "digit": [np.ascontiguousarray(np.rot90(f)) for f in draw_frames(20, 5)],
    }
    for name, images in frames.items():
        (touch / name).mkdir(parents=True)
        for index, image in enumerate(images):
            (touch / name / f"{index}.png").write_bytes(encode(image))
    for name in ("duragel", "img_digit", "img_gelsight"):
        (touch / name).mkdir()
    recording = open_recording(touch)
    assert [(s.name, s.n_frames) for s in recording.streams] == [
        ("gelsight_mini", 12),
        ("digit", 12),
    ]
    (tmp_path / "tacquad" / "contact_indoor.csv").write_text("apple_0,7,11,11,19,0,5\n")
    recording = open_recording(tmp_path / "tacquad")
    mini, digit = recording.streams
    assert mini.n_frames == digit.n_frames == 5
    for index in range(5):
        np.testing.assert_array_equal(mini.frame(index).image, frames["gelsight"][7 + index])
        np.testing.assert_array_equal(digit.frame(index).image, frames["digit"][11 + 2 * index])
    np.testing.assert_array_equal(mini.frame(4).reference, frames["gelsight"][0])
    with pytest.raises(FileProblem):
        mini.frame(5)


def test_dialogs_and_help_name_them():
    assert "MCAP (*.mcap)" in make_dialog_filter()
    for title in ("MCAP (.mcap)", "LeRobot data set (folder)", "TacQuad touch (folder)"):
        assert title in describe_formats()


@pytest.mark.parametrize(
    ("row", "unlisted"),
    [
        ("pear_0,7,11,11,19,0,5", "gelsight_mini and digit"),
        ("apple_0,7,11,99,12,0,5", "digit"),
        (None, "gelsight_mini and digit"),
    ],
)
def test_a_tacquad_touch_that_the_table_lacks_is_paired_with_a_warning(tmp_path, row, unlisted):
    touch = tmp_path / "tacquad" / "data_indoor" / "apple_0"
    for sensor, numbers in (("gelsight", range(5, 15)), ("digit", range(10, 20))):
        (touch / sensor).mkdir(parents=True)
        for number in numbers:
            image = np.full((24, 32, 3), (number, 60, 90), np.uint8)
            cv2.imwrite(str(touch / sensor / f"{number}.png"), image)
    if row is not None:
        (tmp_path / "tacquad" / "contact_indoor.csv").write_text(f"{row}\n")
    notes = open_recording(touch).notes
    (warning,) = (note for note in notes if isinstance(note, StageWarning))
    assert f"in contact of {unlisted}, so the whole film is taken" in warning
    assert not any(note.startswith("the sensors touched one after the other") for note in notes)
