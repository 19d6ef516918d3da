"""What a file states is checked before it is read: no few bytes fill the memory or the evening."""

from __future__ import annotations

import json
import os
import resource
import shutil
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import torch

from pipeline.core import files
from pipeline.core.errors import FileProblem, ModelMissing, TouchError
from pipeline.core.torch_archive import load_torch_file
from pipeline.core.values.frames import TactileFrame
from pipeline.io import image_files, open_recording
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.tasks import rollout_file
from pipeline.stages.networks import network_factory, published_weights
from pipeline.stages.networks.published_weights import read_tensors
from pipeline.stages.networks.weights import Weights, load_weights

SAMPLES = Path(__file__).parents[2] / "sample_data" / "recordings"


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def test_an_image_of_30000_a_side_is_refused_by_its_head(tmp_path, capfd):
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0))
    rest = png_chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + png_chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + rest)
    with pytest.raises(FileProblem, match="too large"):
        image_files.read_rgb(tmp_path / "a.png")
    assert capfd.readouterr().err == ""


def test_arrays_that_unfold_are_refused_by_their_table_of_contents(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(100_000))
    assert (tmp_path / "a.npz").stat().st_size < 2000
    monkeypatch.setattr(files.require_budget, "__kwdefaults__", {"field": None, "most": 100_000})
    with pytest.raises(FileProblem, match="the arrays would take"):
        files.read_arrays(tmp_path / "a.npz", "the arrays")


def test_a_video_that_states_more_frames_than_it_can_hold_is_refused(tmp_path):
    path = tmp_path / "a.avi"
    video = cv2.VideoWriter(os.fspath(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for _ in range(5):
        video.write(np.zeros((48, 64, 3), np.uint8))
    video.release()
    content = bytearray(path.read_bytes())
    for name, at in ((b"avih", 24), (b"strh", 40)):
        start = content.index(name) + at
        content[start : start + 4] = struct.pack("<I", 9_000_000)
    path.write_bytes(content)
    with pytest.raises(FileProblem, match="the video cannot be opened"):
        open_recording(path)


@pytest.mark.parametrize("wrong", [{"levels": 10**9}, {"base_channels": 10**9}, {"levels": 0}])
def test_weights_that_state_a_network_beyond_their_tensors_are_refused(wrong):
    config = {"inputs": 1, "outputs": 1, "base_channels": 4, "levels": 2, **wrong}
    tensors = {"start.weight": np.zeros((4, 4, 3, 3), np.float32)}
    weights = Weights(name="w", kind="compact_unet", config=config, tensors=tensors)
    with pytest.raises(ModelMissing):
        network_factory.load_network(weights)


_PEAK_MB = """
import resource, sys
from pipeline.io import open_recording
import cv2, h5py
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
before = peak()
recording = open_recording(sys.argv[1])
recording.streams[0].frame(5)
print(recording.streams[0].n_frames, peak() - before)
"""


def test_a_recording_that_was_cut_short_is_not_copied_into_memory(tmp_path):
    path = tmp_path / "cut.h5"
    rng = np.random.default_rng(0)
    reference = rng.integers(0, 255, (320, 240, 3), np.uint8)
    with RecordingWriter(path) as writer:
        for index in range(300):
            image = np.roll(reference, index)
            writer.append(
                "a",
                TactileFrame(
                    sensor="digit", image=image, reference=reference, index=index, time_s=index
                ),
            )
    n_bytes = path.stat().st_size
    assert n_bytes > 40e6
    os.truncate(path, n_bytes * 9 // 10)
    done = subprocess.run(
        [sys.executable, "-c", _PEAK_MB, path], capture_output=True, text=True, check=True
    )
    n_frames, grown_mb = done.stdout.split()
    assert int(n_frames) > 200
    assert float(grown_mb) < 30.0


def refuse(path, read):
    """The sentence by which `read` refuses a file; it may take 20 s of CPU and 2 GB in all."""
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(TouchError) as caught:
        read(path)
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_utime - before.ru_utime < 20.0
    assert after.ru_maxrss < max(2e6, 1.2 * before.ru_maxrss)  # kB
    return str(caught.value)


def write_archive(path, description, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {"data.pkl": description, "version": b"3\n", **members}.items():
            archive.writestr(f"archive/{name}", content)


DESCRIPTIONS = {
    "lists": b"\x80\x02" + b"]" * (20 << 20) + b".",
    "classes": b"\x80\x02" + b"".join(b"ca\nb%d\n0" % k for k in range(200_000)) + b"N.",
    "a number of an object": b"\x80\x02]r\xff\xff\xff\x7f.",
    "a shared table": b"\x80\x02}q\x00"
    + b"".join(b"X\x06\0\0\0%06dh\x00s" % k for k in range(100_000))
    + b".",
    "many tables": b"\x80\x02}" + b"".join(b"X\x06\0\0\0%06d}s" % k for k in range(100_000)) + b".",
}


@pytest.mark.parametrize("kind", DESCRIPTIONS)
def test_a_checkpoint_whose_description_unfolds_is_refused(tmp_path, kind):
    path = tmp_path / "w.pt"
    write_archive(path, DESCRIPTIONS[kind])
    assert "w.pt" in refuse(path, read_tensors)
    path.rename(tmp_path / "w2.pt")
    assert "w2.pt" in refuse(tmp_path / "w2.pt", lambda p: open_recording(p, sensor="gelslim"))


def test_members_that_unfold_are_not_read(tmp_path):
    path = tmp_path / "w.pt"
    write_archive(path, b"\x80\x02}.", byteorder=bytes(300 << 20))
    assert "would take" in refuse(path, read_tensors)


def test_a_tensor_beyond_the_budget_is_refused_by_its_table(tmp_path):
    tensors = {
        name: torch.zeros(4)
        for name in ("inc.double_conv.0.weight", "outc.conv.weight", "up.0.up.weight")
    }
    path = tmp_path / "w.pt"
    torch.save(tensors, path)
    table = {name: tensor.expand(1 << 31, 4) for name, tensor in load_torch_file(path).items()}
    with pytest.raises(FileProblem, match="would take"):
        published_weights._read_selected(table, {name: name for name in table}, path)


def test_weights_that_state_more_than_they_may_hold_are_refused_by_their_head(tmp_path):
    path = tmp_path / "w.safetensors"
    n = 1 << 31
    head = json.dumps({"a": {"dtype": "U8", "shape": [n], "data_offsets": [0, n]}}).encode()
    with path.open("wb") as file:
        file.write(len(head).to_bytes(8, "little") + head)
        file.truncate(8 + len(head) + n)
    for read in (load_weights, read_tensors):
        assert "would take 8.6 GB" in refuse(path, read)


def test_tables_of_a_recording_that_unfold_are_refused(tmp_path):
    path = tmp_path / "a.h5"
    shutil.copy(SAMPLES / "no_contact.h5", path)
    with h5py.File(path, "r+") as file:
        group = file.create_group("rollout")
        for key in ("time", "commanded"):
            group.create_dataset(
                key,
                (9_000_000, *((4, 4) if key != "time" else ())),
                "f8",
                chunks=(4096, *((4, 4) if key != "time" else ())),
                compression="gzip",
            ).attrs["unit"] = "s"
    assert path.stat().st_size < 10 << 20
    assert "would take" in refuse(path, rollout_file.read_outcome)
    with h5py.File(path, "r+") as file:
        for k in range(20):
            file.create_dataset(f"table{k}", (9_000_000,), "f8", chunks=(4096,), compression="gzip")
    assert "would take" in refuse(path, open_recording)


def test_a_group_of_rows_is_read_row_by_row(tmp_path):
    """One blob of 8 MB in 300 rows: 2.4 GB as a whole."""
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    blob = cv2.imencode(".png", np.full((320, 427, 3), 90, np.uint8))[1].tobytes() + bytes(8 << 20)
    name = "observation.images.tactile"
    (tmp_path / "meta").mkdir()
    (tmp_path / "data").mkdir()
    info = {"fps": 10, "features": {name: {"dtype": "image"}}, "total_episodes": 1}
    (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    cells = pyarrow.DictionaryArray.from_arrays(
        pyarrow.array([0] * 300, pyarrow.int32()), pyarrow.array([blob], pyarrow.binary())
    )
    parquet.write_table(
        pyarrow.table({name: cells}), tmp_path / "data" / "a.parquet", row_group_size=300
    )
    child = subprocess.run(
        [sys.executable, "-c", _PEAK_MB, tmp_path],
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
    )
    n_frames, peak_mb = child.stdout.split()
    assert int(n_frames) == 300
    assert float(peak_mb) < 500.0


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_is_no_file_is_not_opened(tmp_path, kind):
    """Reading it would wait for ever, or never end."""
    folder = tmp_path / "data_indoor" / "object"
    for sensor, shape in (("gelsight", (240, 320, 3)), ("digit", (320, 240, 3))):
        (folder / sensor).mkdir(parents=True)
        for k in range(3):
            cv2.imwrite(os.fspath(folder / sensor / f"{k}.png"), np.full(shape, 90, np.uint8))
    (tmp_path / "set" / "meta").mkdir(parents=True)
    (tmp_path / "set" / "data").mkdir()
    info = {"fps": 10, "features": {"tactile": {"dtype": "image"}}}
    (tmp_path / "set" / "meta" / "info.json").write_text(json.dumps(info))
    for path, opened in (
        (tmp_path / "contact_a.csv", folder),
        (tmp_path / "set" / "data" / "a.parquet", tmp_path / "set"),
    ):
        os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
        with pytest.raises(FileProblem, match="a pipe or a device"):
            open_recording(opened)


def test_a_field_of_any_length_in_a_table_is_refused_in_a_sentence(tmp_path):
    folder = tmp_path / "data_indoor" / "object"
    for sensor, shape in (("gelsight", (240, 320, 3)), ("digit", (320, 240, 3))):
        (folder / sensor).mkdir(parents=True)
        cv2.imwrite(os.fspath(folder / sensor / "0.png"), np.full(shape, 90, np.uint8))
    (tmp_path / "contact_a.csv").write_text(f"object,{'9' * 200_000},6,3,7,1\n")
    with pytest.raises(FileProblem, match="table of contacts cannot be read"):
        open_recording(folder)
