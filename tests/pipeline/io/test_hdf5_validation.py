"""Recordings from strangers: whatever one dataset is turned into, the file is refused or read as
the layout says.
"""

from __future__ import annotations

import os
import shutil
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, TouchError
from pipeline.io import hdf5, open_recording
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.io.inspection.recording_report import format_report_lines, inspect_recording

REAL = Path(__file__).parents[3] / "sample_data" / "recordings" / "grasps_lines_120.h5"
SECRET = b"what only the reader of the recording may see" * 100


def datasets_of(path: Path) -> list[str]:
    names: list[str] = []
    with h5py.File(path) as file:
        file.visititems(
            lambda name, part: names.append(name) if isinstance(part, h5py.Dataset) else None
        )
    return names


def cut_down(path: Path) -> Path:
    """The real recording with its first two frames alone, so that a test may change it often."""
    with (
        closing(hdf5.read(REAL)) as real,
        RecordingWriter(
            path,
            object_mesh=real.object_mesh,
            symmetry=real.symmetry,
            pairings=real.pairings,
            notes=real.notes,
            coding="row differences",
            depth_step_mm=0.05,
        ) as writer,
    ):
        for stream in real.streams:
            for index in range(2):
                writer.append(stream.name, stream.frame(index), stream.truth(index))
    return path


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    return cut_down(tmp_path_factory.mktemp("border") / "small.h5")


TYPES = {
    "text": lambda v: np.full(v.shape, b"abc", "S3"),
    "complex": lambda v: v.astype(np.complex64),
    "pairs": lambda v: np.zeros(v.shape, [("a", "f4"), ("b", "i2")]),
    "truth values": lambda v: v.astype(bool),
    "objects": lambda v: np.full(v.shape, "word", object),
}
SHAPES = {
    "one row too many": lambda v: np.concatenate([v, v[:1]]),
    "one row too few": lambda v: v[:-1],
    "no rows": lambda v: v[:0],
    "one dimension more": lambda v: v[..., None],
    "one number": lambda v: v.reshape(-1)[0],
    "flat": lambda v: v.reshape(-1),
    "one column less": lambda v: v[..., :-1],
    "turned": lambda v: np.ascontiguousarray(v.T),
}
NUMBERS = ("u1", "i1", "u2", "i4", "i8", "u8", "f2", "f4", "f8", ">f4", ">i4", "f16")


def read_all(path: Path) -> bool:
    """Whether the recording is refused, as a whole or in part.

    What is not must be as the contract has it.
    """
    refused = False
    try:
        recording = open_recording(path)
    except TouchError as error:
        if path.name in str(error):
            return True
        raise
    with closing(recording):
        for stream in recording.streams:
            for index in range(stream.n_frames):
                try:
                    frame = stream.frame(index)
                    truth = stream.truth(index)
                except FileProblem:
                    refused = True
                    continue
                rows_cols = frame.image.shape[:2]
                assert frame.image.dtype == (np.float32 if frame.is_depth else np.uint8)
                assert frame.reference is None or frame.reference.shape == frame.image.shape
                assert isinstance(frame.time_s, float)
                if truth is not None:
                    assert truth.indentation_mm is None or truth.indentation_mm.shape == rows_cols
                    assert truth.contact is None or (truth.contact.shape, truth.contact.dtype) == (
                        rows_cols,
                        np.bool_,
                    )
                    assert truth.sensor_from_object is None or truth.sensor_from_object.shape == (
                        4,
                        4,
                    )
        mesh = recording.object_mesh
        assert mesh is None or mesh.vertices_mm[mesh.triangles].shape == (len(mesh.triangles), 3, 3)
        assert all(pair.target_from_source.shape == (4, 4) for pair in recording.pairings)
    return refused


ROWS = {"one row too many", "one row too few", "no rows"}
ANY_ROWS = {
    "references",
    "rotations",
    "vertices",
    "triangles",
    "indentation",
    "contact",
    "sensor_from_object",
    "force",
}


@pytest.mark.parametrize("name", datasets_of(REAL))
def test_datasets_of_another_type_or_shape_are_refused(tmp_path: Path, small: Path, name: str):
    """Every type that is no number and every other shape is refused.

    Another width of number is read or refused.
    """
    refusals = 0
    with h5py.File(small) as file:
        values = file[name][()]
    for what, change in (TYPES | SHAPES).items():
        path = changed(small, tmp_path, name, change(values))
        kept_shape = what in SHAPES and change(values).shape == values.shape
        harmless = kept_shape or (what in ROWS and name.rpartition("/")[2] in ANY_ROWS)
        refused = read_all(path)
        assert refused or harmless, what
        refusals += refused
    assert refusals >= len(TYPES) + len(SHAPES) - len(ROWS) - 1
    for kind in NUMBERS:
        read_all(changed(small, tmp_path, name, np.zeros(values.shape, kind)))


def changed(small: Path, folder: Path, name: str, values: np.ndarray, **options: object) -> Path:
    """A copy of the recording with other values in one dataset, its attributes kept."""
    path = shutil.copyfile(small, folder / "odd.h5")
    if values.dtype == object:
        options["dtype"] = h5py.string_dtype()
    with h5py.File(path, "r+") as file:
        attributes = dict(file[name].attrs)
        del file[name]
        made = file.create_dataset(name, data=values, **options)
        made.attrs.update(attributes)
    return path


def edited(small: Path, folder: Path, edit) -> Path:
    path = shutil.copyfile(small, folder / "odd.h5")
    with h5py.File(path, "r+") as file:
        edit(file)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(FileProblem) as caught:
        open_recording(path).close()
    return str(caught.value)


STREAM = "streams/gelslim"


def elsewhere(file: h5py.File, folder: Path, how: str) -> None:
    """Have the frames lie in another file."""
    frames = file[f"{STREAM}/frames"]
    shape = frames.shape
    unit = frames.attrs["unit"]
    secret = folder / "secret"
    secret.write_bytes(SECRET)
    del file[f"{STREAM}/frames"]
    group = file[STREAM]
    if how == "external storage":
        made = group.create_dataset(
            "frames", shape, "u1", external=[(str(secret), 0, h5py.h5f.UNLIMITED)]
        )
    elif how == "virtual":
        layout = h5py.VirtualLayout(shape, "u1")
        layout[:] = h5py.VirtualSource(str(REAL), "streams/gelslim/frames", shape=(60, *shape[1:]))[
            : shape[0]
        ]
        made = group.create_virtual_dataset("frames", layout)
    else:
        link = (
            h5py.ExternalLink(str(REAL), "/streams/gelslim/frames")
            if how == "external link"
            else None
        )
        group["frames"] = link or h5py.SoftLink("/streams/gelslim/references")
        return
    made.attrs["unit"] = unit


@pytest.mark.parametrize(
    ("how", "problem"),
    [
        ("external storage", "lies in another file"),
        ("virtual", "lies in another file"),
        ("external link", "is a link"),
        ("soft link", "is a link"),
    ],
)
def test_frames_that_lie_in_another_file_are_refused(
    tmp_path: Path, small: Path, how: str, problem: str
):
    message = refusal(edited(small, tmp_path, lambda file: elsewhere(file, tmp_path, how)))
    assert f"{STREAM}/frames" in message
    assert problem in message


@pytest.mark.parametrize(
    ("name", "shape", "kind"),
    [
        (f"{STREAM}/frames", (2, 1 << 20, 1 << 20, 3), "u1"),
        ("object/vertices", (1 << 40, 3), "f8"),
        (f"{STREAM}/timestamps", (1 << 40,), "f8"),
        ("object/symmetry/rotations", (1 << 40, 3, 3), "f8"),
    ],
)
def test_declared_sizes_are_refused_before_allocation(
    tmp_path: Path, small: Path, name: str, shape: tuple[int, ...], kind: str
):
    def declare(file: h5py.File) -> None:
        unit = file[name].attrs["unit"]
        del file[name]
        file.create_dataset(name, shape, kind, chunks=(1, *(min(n, 16) for n in shape[1:]))).attrs[
            "unit"
        ] = unit

    path = edited(small, tmp_path, declare)
    assert path.stat().st_size < 2 * small.stat().st_size + 10_000
    message = refusal(path)
    assert name in message
    assert any(
        text in message
        for text in ("cannot be as large as", "must have shape", "GB of memory, more than")
    )


def test_chunks_that_are_too_large_are_refused(tmp_path: Path, small: Path):
    def declare(file: h5py.File) -> None:
        file[STREAM].create_dataset(
            "more", (1, 1 << 15, 1 << 15), "f4", chunks=(1, 1 << 15, 1 << 14)
        )

    assert "chunks that are too large" in refusal(edited(small, tmp_path, declare))


@pytest.mark.parametrize(
    "named", ["/etc/own.toml", "../gelslim", "digit.toml", "dig it", "\x1b[31m"]
)
def test_a_recording_names_a_sensor_and_no_file(tmp_path: Path, small: Path, named: str):
    path = edited(small, tmp_path, lambda file: file[STREAM].attrs.__setitem__("sensor", named))
    assert "is no sensor name" in refusal(path)


@pytest.mark.parametrize(
    "value", [["a text"] * 3000, np.zeros((300, 300)), np.zeros(1, [("a", "f4", 9)])]
)
def test_an_attribute_that_unfolds_is_refused_by_its_type(tmp_path: Path, small: Path, value):
    """One text, referred to thousands of times in a file of 8 MB, would fill gigabytes."""
    path = edited(small, tmp_path, lambda file: file[STREAM].attrs.__setitem__("more", value))
    assert "more is not one number or text" in refusal(path)


def test_a_group_that_holds_itself_is_refused(tmp_path: Path, small: Path):
    path = edited(
        small, tmp_path, lambda file: file["streams"].__setitem__("again", file["streams"])
    )
    assert "parts" in refusal(path)


def test_missing_truth_that_is_marked_as_known_is_refused(tmp_path: Path, small: Path):
    path = edited(small, tmp_path, lambda file: file.__delitem__(f"{STREAM}/truth/contact"))
    assert "truth/contact" in refusal(path)


def test_a_mesh_with_missing_vertices_is_refused(tmp_path: Path, small: Path):
    with h5py.File(small) as file:
        triangles = file["object/triangles"][()]
    triangles[0, 0] = 1 << 30
    with pytest.raises(TouchError, match="invalid vertex indices"):
        open_recording(changed(small, tmp_path, "object/triangles", triangles))


def test_control_characters_and_markup_in_a_recording_are_escaped(tmp_path: Path, small: Path):
    """Notes, names and times that would clear the screen, forge a line or colour it."""
    evil = "\x1b[2J\x1b[31mowned\r\u202e[bold]x[/bold]"

    def edit(file: h5py.File) -> None:
        file.attrs["notes"] = evil
        file["object"].attrs["name"] = evil
        file["streams"].move("gelslim", evil.replace("/", "|"))

    report = inspect_recording(edited(small, tmp_path, edit))
    text = "".join(format_report_lines(report))
    assert "\\x1b[2J" in text
    assert not any(mark in text for mark in "\x1b\r\u202e\n")


@pytest.mark.parametrize("name", ["a.h5", "a.pt", "a.npz", "a.png", "a.mp4", "a"])
def test_pipes_and_devices_are_refused_at_once(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    (tmp_path / "device.h5").symlink_to("/dev/zero")
    for path in (tmp_path / name, tmp_path / "device.h5"):
        assert "a pipe or a device" in refusal(path)


def test_a_text_of_a_declared_length_is_refused_before_it_is_read(tmp_path: Path, small: Path):
    path = tmp_path / "long.h5"
    shutil.copyfile(small, path)
    with h5py.File(path, "r+", libver="latest") as file:
        file[STREAM].attrs["more"] = np.bytes_(b"x" * 60_000)
    with closing(hdf5.read(path)):
        pass
    with h5py.File(path, "r+", libver="latest") as file:
        file["pairs"] = np.zeros(1)
        del file["pairs"]
        group = file[STREAM].create_group("dense", track_order=True)
        for k in range(9):  # more than eight attributes are stored densely, where they may be long
            group.attrs[f"a{k}"] = k
        group.attrs["more"] = np.bytes_(b"x" * 90_000)
    assert "more is not one number or text" in refusal(path)
