"""Our own recordings: what goes in comes out, and damage stays where it is."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.arrays import freeze
from pipeline.core.errors import CalibrationError, FileProblem, ShapeError
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import Pairing, Recording, TactileFrame, Truth
from pipeline.io import open_recording
from pipeline.io.hdf5_layout import BUBBLE_STEP_MM, GEL_STEP_MM
from pipeline.io.hdf5_writer import RecordingWriter

N_FRAMES = 12
FLOAT_ROUNDING_MM = 2e-6  # of float32 below 32 mm


def gel_frame(
    index: int, shape: tuple[int, int] = (40, 60), reference: bool = True
) -> TactileFrame:
    rng = np.random.default_rng(index)
    image = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
    untouched = np.random.default_rng(99).integers(0, 256, (*shape, 3), dtype=np.uint8)
    return TactileFrame(
        sensor="gelslim",
        image=image,
        reference=untouched if reference else None,
        index=index,
        time_s=0.1 * index,
    )


def bubble_frame(index: int) -> TactileFrame:
    rng = np.random.default_rng(1000 + index)
    depth = rng.uniform(60.0, 80.0, (14, 17)).astype(np.float32)
    depth[0, 0] = np.nan
    camera = Camera(rows=14, cols=17, fx_px=18.0, fy_px=19.0, cx_px=8.0, cy_px=6.5)
    return TactileFrame(
        sensor="soft_bubble",
        image=depth,
        reference=np.full((14, 17), 80, np.float32),
        index=index,
        camera=camera,
    )


def gel_truth(index: int, shape: tuple[int, int] = (40, 60)) -> Truth:
    depth = np.random.default_rng(index).uniform(-0.1, 1.9, shape).astype(np.float32)
    depth[3, 4] = np.nan
    return Truth(
        indentation_mm=depth,
        contact=depth > 1.0,
        sensor_from_object=rigid.from_parts((1.0, 2.0, index), (0, 0, 5)),
    )


MESH = Mesh(
    vertices_mm=freeze(np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]])),
    triangles=freeze(np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)),
    name="corner",
)
PAIR = Pairing(
    source="gelslim",
    target="bubble",
    target_from_source=rigid.from_parts((1.0, -2.0, 60.0), (0.0, 0.0, 180.0)),
)


def written(path: Path, n_frames: int = N_FRAMES, **options) -> Path:
    with RecordingWriter(
        path, object_mesh=MESH, pairings=(PAIR,), notes=("made by a test",), **options
    ) as writer:
        for index in range(n_frames):
            writer.append("gelslim", gel_frame(index), gel_truth(index))
            writer.append("bubble", bubble_frame(index))
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    return written(tmp_path_factory.mktemp("recordings") / "a.h5")


@pytest.fixture
def recording(file: Path):
    opened = open_recording(file)
    yield opened
    opened.close()


def readable(recording: Recording, name: str) -> list[int]:
    """The frames of a stream that can be read and hold what was written.

    Any wrong pixel fails the test.
    """
    good: list[int] = []
    stream = recording.stream(name)
    for index in range(stream.n_frames):
        try:
            frame = stream.frame(index)
        except FileProblem:
            continue
        want = gel_frame(index) if name == "gelslim" else bubble_frame(index)
        np.testing.assert_array_equal(frame.image, want.image)
        good.append(index)
    return good


def test_frames_are_read_as_written(recording: Recording):
    assert [s.name for s in recording.streams] == ["gelslim", "bubble"]
    assert readable(recording, "gelslim") == readable(recording, "bubble") == list(range(N_FRAMES))
    frame = recording.stream("gelslim").frame(3)
    assert (frame.sensor, frame.index, frame.time_s) == ("gelslim", 3, pytest.approx(0.3))
    np.testing.assert_array_equal(frame.reference, gel_frame(3).reference)
    assert not frame.image.flags.writeable
    assert recording.notes == ("made by a test",)


def test_truth_is_read_within_a_twentieth_of_a_micrometre(recording: Recording):
    truth = recording.stream("gelslim").truth(5)
    want = gel_truth(5)
    np.testing.assert_allclose(
        truth.indentation_mm, want.indentation_mm, atol=GEL_STEP_MM / 2 + FLOAT_ROUNDING_MM
    )
    assert np.isnan(truth.indentation_mm[3, 4])
    np.testing.assert_array_equal(truth.contact, want.contact)
    np.testing.assert_array_equal(truth.sensor_from_object, want.sensor_from_object)
    assert recording.stream("bubble").truth(5) is None
    assert not recording.stream("bubble").has_truth


def test_mesh_camera_and_pairing_are_read_as_written(recording: Recording):
    np.testing.assert_array_equal(recording.object_mesh.vertices_mm, MESH.vertices_mm)
    np.testing.assert_array_equal(recording.object_mesh.triangles, MESH.triangles)
    assert recording.object_mesh.name == "corner"
    assert recording.stream("bubble").frame(0).camera == bubble_frame(0).camera
    assert recording.stream("gelslim").frame(0).camera is None
    there = recording.target_from_source("gelslim", "bubble")
    back = recording.target_from_source("bubble", "gelslim")
    # float64 rounding of lengths below 100 mm
    np.testing.assert_allclose(there @ back, np.eye(4), atol=1e-9)
    assert recording.target_from_source("gelslim", "digit") is None


def test_row_differences_are_lossless_and_smaller_for_smooth_images(tmp_path: Path):
    smooth = np.add.outer(np.arange(120), np.arange(160))[..., None] % 256 + np.zeros(3)
    noisy = smooth + np.random.default_rng(0).normal(0, 1.2, smooth.shape)
    image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    sizes = []
    for coding in ("plain", "row differences"):
        with RecordingWriter(tmp_path / "x.h5", coding=coding) as writer:
            writer.append(
                "gel",
                TactileFrame(sensor="gelslim", image=image, reference=None),
                gel_truth(0, (120, 160)),
            )
        sizes.append((tmp_path / "x.h5").stat().st_size)
        opened = open_recording(tmp_path / "x.h5")
        np.testing.assert_array_equal(opened.streams[0].frame(0).image, image)
        want = gel_truth(0, (120, 160)).indentation_mm
        got = opened.streams[0].truth(0).indentation_mm
        np.testing.assert_allclose(got, want, atol=GEL_STEP_MM / 2 + FLOAT_ROUNDING_MM)
        opened.close()
    assert sizes[1] < sizes[0]


@settings(max_examples=15)
@given(step_mm=st.sampled_from([0.001, 0.002]), seed=st.integers(0, 1000))
def test_stepped_depth_is_off_by_half_a_step_at_most(tmp_path_factory, step_mm: float, seed: int):
    depth = np.random.default_rng(seed).uniform(0, 65.0, (6, 7)).astype(np.float32)
    depth[2, 3] = np.nan
    path = tmp_path_factory.mktemp("s") / "s.h5"
    with RecordingWriter(path, depth_step_mm=step_mm, coding="row differences") as writer:
        writer.append("bubble", TactileFrame(sensor="soft_bubble", image=depth, reference=depth))
    opened = open_recording(path)
    float_rounding_mm = 8e-6  # of float32 at 65 mm
    np.testing.assert_allclose(
        opened.streams[0].frame(0).image, depth, atol=step_mm / 2 + float_rounding_mm
    )
    opened.close()


def test_a_length_that_does_not_fit_its_steps_is_refused(tmp_path: Path):
    truth = Truth(indentation_mm=np.full((40, 60), 5.0, np.float32))
    with (
        pytest.raises(ShapeError, match=r"truth/indentation of frame 0 holds 5 mm"),
        RecordingWriter(tmp_path / "x.h5") as writer,
    ):
        writer.append("gelslim", gel_frame(0), truth)
    assert list(tmp_path.iterdir()) == []
    # mm, the deepest imprint of the published pairs
    assert BUBBLE_STEP_MM * np.iinfo(np.int16).max > 22.5


def test_truth_that_begins_late_is_unknown_before(tmp_path: Path):
    with RecordingWriter(tmp_path / "x.h5") as writer:
        writer.append("g", gel_frame(0))
        writer.append("g", gel_frame(1), Truth(contact=np.ones((40, 60), bool)))
        writer.append("g", gel_frame(2), gel_truth(2))
        writer.append("g", gel_frame(3))
    opened = open_recording(tmp_path / "x.h5")
    truths = [opened.streams[0].truth(i) for i in range(4)]
    assert truths[0] is None
    assert truths[3] is None
    assert truths[1].indentation_mm is None
    assert truths[1].contact.all()
    assert truths[2].sensor_from_object is not None
    opened.close()


def test_append_continues_a_recording(tmp_path: Path):
    path = written(tmp_path / "a.h5", 3)
    with RecordingWriter.open_for_append(path) as writer:
        writer.append("gelslim", gel_frame(3), gel_truth(3))
    opened = open_recording(path)
    assert readable(opened, "gelslim") == [0, 1, 2, 3]
    assert readable(opened, "bubble") == [0, 1, 2]
    np.testing.assert_array_equal(
        opened.stream("gelslim").frame(3).reference, gel_frame(3).reference
    )
    opened.close()


@pytest.mark.parametrize("step_mm", [0.0, 0.05])
def test_append_stores_no_reference_twice(tmp_path: Path, step_mm: float):
    path = written(tmp_path / "a.h5", 2, depth_step_mm=step_mm)
    for index in (2, 3):
        with RecordingWriter.open_for_append(path) as writer:
            writer.append("gelslim", gel_frame(index))
            writer.append("bubble", bubble_frame(index))
    with h5py.File(path) as file:
        assert [len(file[f"streams/{name}/references"]) for name in ("gelslim", "bubble")] == [1, 1]
    opened = open_recording(path)
    np.testing.assert_array_equal(
        opened.stream("gelslim").frame(3).reference, gel_frame(3).reference
    )
    opened.close()


def test_an_interrupted_write_leaves_the_file_as_it_was(tmp_path: Path):
    path = written(tmp_path / "a.h5", 2)
    before = path.read_bytes()
    with (
        pytest.raises(ShapeError, match="frame 2 of 'gelslim' must have shape"),
        RecordingWriter.open_for_append(path) as writer,
    ):
        writer.append("gelslim", gel_frame(2, (20, 20)))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_frames_share_an_equal_reference_and_keep_different_ones(tmp_path: Path):
    path = tmp_path / "two.h5"
    with RecordingWriter(path) as writer:
        for index in range(4):
            still = np.full((8, 9, 3), 100 + index // 2, np.uint8)
            writer.append(
                "gel", TactileFrame(sensor="gelslim", image=still, reference=still, index=index)
            )
    stream = open_recording(path).streams[0]
    references = [stream.frame(index).reference for index in (0, 1, 2, 3, 0)]
    assert references[0] is references[1]
    assert references[2] is references[3]
    assert [int(reference.max()) for reference in references] == [100, 100, 101, 101, 100]


def test_a_rewritten_recording_is_equal(tmp_path: Path, recording: Recording):
    with RecordingWriter(tmp_path / "copy.h5") as writer:
        for stream in recording.streams:
            for index in range(stream.n_frames):
                writer.append(stream.name, stream.frame(index), stream.truth(index))
    copy = open_recording(tmp_path / "copy.h5")
    assert readable(copy, "gelslim") == readable(copy, "bubble") == list(range(N_FRAMES))
    a = copy.stream("gelslim").truth(7)
    b = recording.stream("gelslim").truth(7)
    np.testing.assert_array_equal(a.indentation_mm, b.indentation_mm)
    copy.close()


@pytest.mark.parametrize("share", [0.9, 0.6, 0.45])
def test_a_truncated_file_keeps_its_earlier_frames(
    tmp_path: Path, file: Path, share: float, monkeypatch
):
    data = file.read_bytes()
    path = tmp_path / "cut.h5"
    path.write_bytes(data[: int(len(data) * share)])
    monkeypatch.setattr(Path, "read_bytes", lambda _: pytest.fail("the whole file is in memory"))
    opened = open_recording(path)
    assert any("cut short" in note for note in opened.notes)
    good = readable(opened, "gelslim")
    assert good == list(range(len(good)))  # frames lie in order, so what is left is a beginning
    # the table of contents, set aside in front, takes their room
    assert len(good) >= int(N_FRAMES * share) - 4
    frame = opened.stream("gelslim").frame(0)
    np.testing.assert_array_equal(frame.reference, gel_frame(0).reference)
    assert opened.stream("gelslim").frame(good[-1]).time_s == pytest.approx(0.1 * good[-1])
    assert opened.stream("gelslim").truth(0).sensor_from_object is not None
    with pytest.raises(
        FileProblem,
        match=rf"frame {len(good)} of 'gelslim': its frames are damaged or cut off.*cut\.h5",
    ):
        opened.stream("gelslim").frame(len(good))
    opened.close()


def test_a_file_cut_within_its_table_of_contents_is_refused(tmp_path: Path, file: Path):
    path = tmp_path / "stub.h5"
    path.write_bytes(file.read_bytes()[:700])
    with pytest.raises(
        FileProblem, match=r"cut short before its table of contents|table of contents is damaged"
    ):
        open_recording(path)


def test_a_flipped_byte_costs_one_frame_and_is_named(tmp_path: Path, file: Path):
    path = tmp_path / "flipped.h5"
    data = bytearray(file.read_bytes())
    with h5py.File(file, "r") as f:
        data[f["streams/gelslim/frames"].id.get_chunk_info(4).byte_offset + 100] ^= 0x10
        data[f["streams/gelslim/truth/contact"].id.get_chunk_info(2).byte_offset + 30] ^= 0x10
    path.write_bytes(data)
    opened = open_recording(path)
    assert readable(opened, "gelslim") == [i for i in range(N_FRAMES) if i != 4]
    with pytest.raises(FileProblem, match=r"frame 4 of 'gelslim': its frames are damaged"):
        opened.stream("gelslim").frame(4)
    with pytest.raises(FileProblem, match=r"frame 2 of 'gelslim': its truth/contact"):
        opened.stream("gelslim").truth(2)
    opened.close()


def test_no_flipped_byte_changes_an_image_unnoticed(tmp_path: Path):
    path = written(tmp_path / "a.h5", 3)
    data = path.read_bytes()
    rng = np.random.default_rng(5)
    n_read = 0
    for _ in range(40):
        flipped = bytearray(data)
        flipped[int(rng.integers(8, len(data)))] ^= 1 << int(rng.integers(8))
        (tmp_path / "b.h5").write_bytes(flipped)
        try:
            opened = open_recording(tmp_path / "b.h5")
        except (FileProblem, CalibrationError):
            continue
        for stream in opened.streams:
            n_read += len(readable(opened, stream.name))
        opened.close()
    assert n_read > 0.5 * 40 * 6  # most flips hit one chunk of one frame, or nothing at all


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: f.attrs.__setitem__("format_version", 2),
            "format version 2 and this program reads up to 1",
        ),
        (lambda f: f.attrs.__delitem__("format"), "not a tactoscope recording"),
        (
            lambda f: f["streams/bubble/frames"].attrs.__setitem__("unit", "m"),
            "streams/bubble/frames is given in 'm', want 'mm'",
        ),
        (
            lambda f: f["streams/gelslim/truth/indentation"].attrs.__delitem__("unit"),
            "streams/gelslim/truth/indentation has no unit",
        ),
        (
            lambda f: f["streams/bubble/camera_matrix"].__setitem__((0, 0), 0.0),
            "camera_matrix is singular",
        ),
    ],
)
def test_content_that_does_not_fit_the_format_is_refused_by_name(
    tmp_path: Path, change, message: str
):
    path = written(tmp_path / "a.h5", 1)
    with h5py.File(path, "r+") as f:
        change(f)
    with pytest.raises((FileProblem, CalibrationError), match=message) as caught:
        open_recording(path)
    assert "a.h5" in str(caught.value)


@pytest.mark.parametrize("truth", [{"force_n": np.zeros(4)}, {"sensor_from_object": np.eye(3)}])
def test_truth_of_another_shape_is_not_written(tmp_path: Path, truth):
    picture = TactileFrame(sensor="digit", image=np.zeros((4, 6, 3), np.uint8), reference=None)
    with (
        pytest.raises(ShapeError, match="of frame 0 must have shape"),
        RecordingWriter(tmp_path / "a.h5") as writer,
    ):
        writer.append("digit", picture, Truth(**truth))


@pytest.mark.parametrize("truth", [{"force_n": np.arange(3.0)}, {"sensor_from_object": np.eye(4)}])
def test_truth_of_the_right_shape_is_read_as_written(tmp_path: Path, truth):
    picture = TactileFrame(sensor="digit", image=np.zeros((4, 6, 3), np.uint8), reference=None)
    with RecordingWriter(tmp_path / "a.h5") as writer:
        writer.append("digit", picture, Truth(**truth))
    ((name, value),) = truth.items()
    np.testing.assert_array_equal(
        getattr(open_recording(tmp_path / "a.h5").stream().truth(0), name), value
    )


def test_a_missing_frame_names_the_range(recording: Recording):
    with pytest.raises(
        FileProblem, match=f"there is no frame {N_FRAMES}, frames are 0 to {N_FRAMES - 1}"
    ):
        recording.stream("gelslim").frame(N_FRAMES)
