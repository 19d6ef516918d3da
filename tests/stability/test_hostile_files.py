"""Whatever a file holds: it is read, or refused in one sentence. `--cases 100` draws 3,500."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import torch

from app.session.file_fingerprints import describe_changed_files, fingerprint_files
from app.session.layout import ComparisonSettings, Layout
from app.session.state import Session, load_session, save_session
from pipeline.calibration import calibration_file
from pipeline.core.entry_points import load_entry_points
from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.values.frames import TactileFrame
from pipeline.io import formats, open_recording
from pipeline.io.formats import FORMATS
from pipeline.io.grasp_files import read_split_file
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.tasks import insertion, rollout_file
from pipeline.lab.tasks.insertion import load_tool, make_tool
from pipeline.lab.tasks.task import Decision, RolloutSummary, TrialPlan, load_task
from pipeline.lab.training.recipe import RECIPES_FOLDER, load_recipe
from pipeline.sensors import kinds
from pipeline.sensors.alignment import load_alignment
from pipeline.sensors.descriptions import find_descriptions
from pipeline.sensors.spec import list_sensor_names, load_sensor
from pipeline.stages.networks import network_factory, published_weights
from pipeline.stages.networks.weights import Weights, load_weights, save_weights
from pipeline.translation.cross_section import SectionLine
from pipeline.translation.reports import repro_bundle
from pipeline.views.display_params import DisplayParams
from tests.pipeline.io.test_data_sets import write_mcap
from tests.stability.hostile import JUNK, spoil_bytes, spoil_value, to_toml
from tests.stability.rows import cases

ROOT = Path(__file__).parents[2]
ALIGNMENT = ROOT / "sample_data" / "alignments" / "digit_to_gelslim.toml"
LONGEST_SENTENCE = 600  # letters, and the path


def try_all(
    read: Callable[[], object], make: Callable[[np.random.Generator], None], share: float
) -> None:
    """Read as many spoilt files as the size asks for: each is read or refused in a short
    sentence.
    """
    for seed in range(cases(share)):
        rng = np.random.default_rng(seed)
        make(rng)
        try:
            read()
        except TouchError as error:
            sentence = str(error)
        except Exception as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
        else:
            sentence = ""
        assert len(sentence) < LONGEST_SENTENCE, (seed, sentence[:300])


def rich_session(folder: Path) -> Session:
    """A session with something in every field."""
    recording = folder / "a.h5"
    shutil.copyfile(ROOT / "sample_data" / "recordings" / "no_contact.h5", recording)
    one = Session(
        recording=recording,
        source="digit",
        target="gelslim",
        reference=recording,
        alignment=ALIGNMENT,
        methods={"target_depth": "paper"},
        weights={"touch": folder / "w.safetensors"},
        params={"display": DisplayParams()},
        layout=Layout(name="look", panes=(("depth", "2D"),)),
        notes={1: "slipped"},
        comparison=ComparisonSettings(tab="grid"),
        cameras={"depth": (1.0,) * 10},
        section=SectionLine(begin_mm=(0.0, 0.0), end_mm=(1.0, 1.0)),
    )
    return dataclasses.replace(one, variant=dataclasses.replace(one, frame=2))


def test_sessions(tmp_path):
    path = tmp_path / "a.touch.json"
    session = rich_session(tmp_path)
    save_session(session, path, fingerprint_files(session))
    content = path.read_bytes()
    plain = json.loads(content)

    def make(rng: np.random.Generator) -> None:
        path.write_bytes(
            spoil_bytes(content, rng)
            if rng.random() < 0.2
            else json.dumps(spoil_value(plain, rng)).encode()
        )

    def read() -> None:
        describe_changed_files(path, load_session(path))

    try_all(read, make, 4.0)


def test_repro_bundles(tmp_path, monkeypatch):
    folder = tmp_path / "bundle"
    folder.mkdir()
    shutil.copyfile(ROOT / "sample_data" / "recordings" / "no_contact.h5", folder / "frame.h5")
    arrays = {
        "depth.indentation_mm": np.zeros((3, 4), np.float32),
        "depth.contact": np.zeros((3, 4), bool),
    }
    np.savez(folder / "expected.npz", **arrays)
    whole = (folder / "expected.npz").read_bytes()
    plain = {
        "tactoscope bundle": 1,
        "note": "it slips",
        "frame": 0,
        "settings": ["cloud.stride=2"],
        "metrics": {"depth.rmse_mm": 0.1},
        "request": {
            "source": "digit",
            "target": "gelslim",
            "stream": "",
            "route": "t2d2",
            "mesh_unit": "auto",
            "depth_unit": "auto",
            "recording": "frame.h5",
            "mesh": None,
            "calibration": None,
            "alignment": None,
            "methods": {"target_depth": "paper"},
            "weights": {"touch": "w.safetensors"},
        },
    }
    monkeypatch.setattr(repro_bundle, "collect_stage_arrays", lambda *_: arrays)

    monkeypatch.setattr(repro_bundle, "_translate", lambda *_: (None, {}, {}))

    def make(rng: np.random.Generator) -> None:
        (folder / "bundle.json").write_text(
            json.dumps(spoil_value(plain, rng) if rng.random() < 0.8 else plain)
        )
        (folder / "expected.npz").write_bytes(
            whole if rng.random() < 0.7 else spoil_bytes(whole, rng)
        )

    try_all(lambda: repro_bundle.replay_bundle(folder), make, 2.0)
    usable = {**plain, "request": {**plain["request"], "weights": {}}}
    removed = json.dumps({**usable, "settings": ["depth.boundary=free"]})
    (folder / "bundle.json").write_text(removed)
    with pytest.raises(FileProblem, match=r"'boundary'.*\"settings\".*bundle\.json"):
        repro_bundle.replay_bundle(folder)


@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")
def test_weights(tmp_path):
    path = tmp_path / "w.safetensors"
    config = {"inputs": 4, "outputs": 2, "base_channels": 8, "levels": 2}
    network = network_factory.build_network("compact_unet", config)
    tensors = {name: tensor.numpy() for name, tensor in network.state_dict().items()}
    save_weights(
        path,
        Weights(
            name="w",
            kind="compact_unet",
            config=config,
            tensors=tensors,
            card={"data": "simulated"},
        ),
    )
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    header["__metadata__"] |= {
        key: json.loads(header["__metadata__"][key]) for key in ("config", "card")
    }

    def make(rng: np.random.Generator) -> None:
        if rng.random() < 0.3:
            path.write_bytes(spoil_bytes(content, rng, head=length + 8))
            return
        spoilt = {**header, "__metadata__": spoil_value(header["__metadata__"], rng)}
        texts = spoilt["__metadata__"]
        spoilt["__metadata__"] = {
            k: v if isinstance(v, str) else json.dumps(v) for k, v in texts.items()
        }
        text = json.dumps(spoilt).encode()
        path.write_bytes(len(text).to_bytes(8, "little") + text + content[8 + length :])

    try_all(lambda: network_factory.load_network(load_weights(path)), make, 1.0)


@pytest.mark.parametrize("kind", ["sensor", "alignment", "recipe"])
def test_descriptions(tmp_path, kind):
    sources = {
        "sensor": sorted(find_descriptions().values()),
        "alignment": [ALIGNMENT],
        "recipe": sorted(RECIPES_FOLDER.glob("*.toml")),
    }
    read = {
        "sensor": lambda p: load_sensor(str(p)),
        "recipe": lambda p: load_recipe(str(p)),
        "alignment": lambda p: load_alignment(p, source="digit", target="gelslim"),
    }
    path = tmp_path / "a.toml"
    contents = [file.read_bytes() for file in sources[kind]]

    def make(rng: np.random.Generator) -> None:
        content = contents[int(rng.integers(len(contents)))]
        plain = tomllib.loads(content.decode())
        text = (
            spoil_bytes(content, rng)
            if rng.random() < 0.2
            else to_toml(spoil_value(plain, rng)).encode()
        )
        path.write_bytes(text)

    try_all(lambda: read[kind](path), make, 2.0)


def test_tools_of_a_task(tmp_path):
    path = tmp_path / "mine.toml"
    mesh = make_tool("spanner").mesh
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices_mm)
    (tmp_path / "mine.obj").write_text(
        corners + "".join(f"f {a} {b} {c}\n" for a, b, c in mesh.triangles + 1)
    )
    plain = {
        "mesh": "mine.obj",
        "depth_mm": 6.0,
        "mesh_unit": "mm",
        "face": "-z",
        "axis_deg": 20.0,
        "lead_in_mm": 0.2,
    }
    try_all(
        lambda: load_tool(path),
        lambda rng: path.write_text(to_toml(spoil_value(plain, rng))) and None,
        0.5,
    )


def test_split_files(tmp_path):
    path = tmp_path / "split.json"
    plain = {"train": [["peg1", 1], ["peg2", "data_2"]], "test": [["peg3", 3]]}
    try_all(
        lambda: read_split_file(path),
        lambda rng: path.write_text(json.dumps(spoil_value(plain, rng))) and None,
        2.0,
    )


def test_calibrations(tmp_path, monkeypatch):
    whole = tmp_path / "whole.npz"
    path = tmp_path / "a.npz"
    calibration_file.save(_calibration(), whole)
    with np.load(whole) as opened:
        arrays = {key: opened[key] for key in opened.files}
    junk = (
        np.float64("nan"),
        np.int64(-1),
        np.int64(2**62),
        "a text",
        np.zeros(0),
        np.zeros((2, 0, 3)),
        np.zeros(5, complex),
        True,
        np.full((3, 3), np.inf),
        np.zeros(2, "M8[s]"),
        np.zeros((4, 4, 4), np.uint8),
        np.arange(3.0),
        np.zeros(1, [("a", "f4")]),
    )

    def make(rng: np.random.Generator) -> None:
        if rng.random() < 0.3:
            path.write_bytes(spoil_bytes(whole.read_bytes(), rng))
            return
        key = sorted(arrays)[int(rng.integers(len(arrays)))]
        np.savez(path, **{**arrays, key: junk[int(rng.integers(len(junk)))]})

    try_all(lambda: calibration_file.load(path), make, 2.0)


def _calibration() -> Any:
    from pipeline.calibration import slope_model
    from pipeline.calibration.calibration_table import Calibration

    exponents = len(slope_model.list_exponents(2))
    model = slope_model.SlopeModel(
        colour_degree=2,
        position_degree=0,
        coefficients=np.zeros((1, 1, exponents, 2), np.float32),
        slope_max=1.0,
    )
    return Calibration(
        sensor="digit",
        rows=240,
        cols=320,
        pixel_mm=0.1,
        model=model,
        origin="balls",
        presses=(),
    )


@pytest.mark.parametrize("suffix", [".h5", ".png", ".avi", ".npy", ".npz", ".tiff", ".mcap"])
def test_headers(tmp_path, suffix, capfd):
    path = tmp_path / f"a{suffix}"
    image = np.random.default_rng(1).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    depth = np.full((3, 24, 32), 40.0, np.float32)
    if suffix == ".h5":
        with RecordingWriter(path) as writer:
            for index in range(2):
                frame = TactileFrame(
                    sensor="digit", image=image, reference=image, index=index, time_s=0.1 * index
                )
                writer.append("one", frame)
    elif suffix == ".avi":
        video = cv2.VideoWriter(os.fspath(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (32, 24))
        for _ in range(3):
            video.write(image)
        video.release()
    elif suffix == ".mcap":
        write_mcap(path, [image] * 3)
    elif suffix in (".npy", ".npz"):
        (np.save if suffix == ".npy" else np.savez)(path, depth)
    else:
        cv2.imwrite(os.fspath(path), image)
    content = path.read_bytes()

    def read() -> None:
        recording = open_recording(path)
        try:
            stream = recording.streams[0]
            for index in range(min(3, stream.n_frames)):
                stream.frame(index)
                stream.truth(index)
        finally:
            recording.close()

    try_all(read, lambda rng: path.write_bytes(spoil_bytes(content, rng, head=4096)) and None, 1.0)
    assert capfd.readouterr().err == "", "only this program speaks"


def _read_frames(path: Path, **options: Any) -> None:
    recording = open_recording(path, **options)
    try:
        for stream in recording.streams:
            for index in range(min(3, stream.n_frames)):
                stream.frame(index)
                stream.truth(index)
    finally:
        recording.close()


def _spoil_file(path: Path, content: bytes, rng: np.random.Generator, head: int = 1 << 30) -> None:
    plain = None
    if path.suffix == ".json" and rng.random() < 0.7:
        plain = json.dumps(spoil_value(json.loads(content), rng)).encode()
    path.write_bytes(spoil_bytes(content, rng, head) if plain is None else plain)


@pytest.mark.parametrize("kind", ["LeRobot", "TacQuad"])
def test_data_sets(tmp_path, kind):
    image = np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    blob = cv2.imencode(".png", image)[1].tobytes()
    if kind == "LeRobot":
        parquet = pytest.importorskip("pyarrow.parquet")
        pyarrow = pytest.importorskip("pyarrow")
        folder = tmp_path
        (folder / "meta").mkdir()
        (folder / "data").mkdir()
        info = {
            "fps": 10,
            "features": {"tactile": {"dtype": "image", "shape": [48, 64, 3]}},
            "total_episodes": 1,
        }
        (folder / "meta" / "info.json").write_text(json.dumps(info))
        table = pyarrow.table(
            {"tactile": [{"bytes": blob, "path": ""}] * 5, "episode_index": [0] * 5}
        )
        parquet.write_table(table, folder / "data" / "a.parquet")
    else:
        folder = tmp_path / "data_indoor" / "object"
        for sensor in ("gelsight", "digit"):
            (folder / sensor).mkdir(parents=True)
            for k in range(3):
                (folder / sensor / f"{k}.png").write_bytes(blob)
        (tmp_path / "contact_indoor.csv").write_text("object,0,2,0,1,0,2\n")
    contents = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    spoilt = sorted(contents)

    def make(rng: np.random.Generator) -> None:
        for path, content in contents.items():
            path.write_bytes(content)
        path = spoilt[int(rng.integers(len(spoilt)))]
        _spoil_file(path, contents[path], rng)

    try_all(lambda: _read_frames(folder), make, 1.0)


def test_checkpoints(tmp_path):
    path = tmp_path / "w.pt"
    names = ("inc.double_conv.0.weight", "outc.conv.weight", "up.0.up.weight")
    state = {
        "state_dict": {f"module.{name}": torch.ones(2, 3, 3, 3) for name in names},
        "epoch": 3,
        "optimizer": [{"lr": 0.1}],
    }
    torch.save(state, path)
    content = path.read_bytes()

    def read() -> None:
        published_weights.read_unet(path)

    def read_recording() -> None:
        _read_frames(path, sensor="gelslim")

    for one in (read, read_recording):
        try_all(one, lambda rng: path.write_bytes(spoil_bytes(content, rng)) and None, 1.0)


def test_rollouts(tmp_path):
    path = tmp_path / "r.h5"
    shutil.copyfile(ROOT / "sample_data" / "recordings" / "no_contact.h5", path)
    pose = np.tile(np.eye(4), (4, 1, 1))
    plan = TrialPlan(
        task="marble", case="bubble", index=0, touches=("true",), tolerances_mm=(1.0,), seed=0
    )
    summary = RolloutSummary(
        case="a",
        trial=0,
        touch="true",
        tolerance_mm=1.0,
        succeeds=True,
        cause="it holds",
        measures={"a_mm": 1.0},
        decisions=(Decision(tick=1, error_mm=0.1),),
    )
    with h5py.File(path, "r+", libver=("v110", "latest")) as file:
        group = file.create_group("rollout")
        tables = {
            "time": (np.arange(4.0), "s"),
            "force": (np.zeros((4, 3)), "N"),
            "commanded": (pose, "mm"),
            "world_from_object": (pose, "mm"),
            "world_from_hand": (pose, "mm"),
        }
        for key, (values, unit) in tables.items():
            group.create_dataset(key, data=values).attrs["unit"] = unit
    plain = {"plan": dataclasses.asdict(plan), "summary": dataclasses.asdict(summary)}
    with h5py.File(path, "r+", libver=("v110", "latest")) as file:
        file["rollout"].attrs.update(
            {**{key: json.dumps(value) for key, value in plain.items()}, "key": "k"}
        )
    rollout_file.read_rollout(path)
    content = path.read_bytes()

    def make(rng: np.random.Generator) -> None:
        if rng.random() < 0.5:
            path.write_bytes(spoil_bytes(content, rng, 4096 if rng.random() < 0.5 else 1 << 30))
            return
        path.write_bytes(content)
        spoilt = spoil_value(plain, rng)
        with h5py.File(path, "r+", libver=("v110", "latest")) as file:
            for key in plain:
                text = json.dumps(spoilt.get(key)).encode("utf-8", "replace").decode()
                file["rollout"].attrs[key] = text[:60_000]

    try_all(lambda: rollout_file.read_rollout(path), make, 2.0)


def test_entry_points(monkeypatch):
    """Whatever another package adds, what is listed for dialogs, options and help is listed."""
    good = {
        "tactoscope.formats": (FORMATS[0], formats.list_formats),
        "tactoscope.sensor_kinds": (kinds.GEL, kinds.list_kinds),
        "tactoscope.tasks": (insertion.TASK, lambda: load_task("stack")),
        "tactoscope.sensors": ("/dev/null", list_sensor_names),
    }
    groups = sorted(good)
    added = list[Any]()
    others = importlib.metadata.entry_points
    monkeypatch.setattr(importlib.metadata.EntryPoint, "load", lambda _: added[-1])
    point = [importlib.metadata.EntryPoint(name="x\x1b", value="lab:x", group="any")]
    monkeypatch.setattr(
        importlib.metadata,
        "entry_points",
        lambda **asked: point if asked.get("group") in good else others(**asked),
    )
    chosen = [groups[0]]

    def make(rng: np.random.Generator) -> None:
        chosen[0] = groups[int(rng.integers(len(groups)))]
        value: Any = good[chosen[0]][0]
        junk = JUNK[int(rng.integers(len(JUNK)))]
        if dataclasses.is_dataclass(value) and not isinstance(value, type) and rng.random() < 0.8:
            names = [field.name for field in dataclasses.fields(value)]
            junk = dataclasses.replace(value, **{names[int(rng.integers(len(names)))]: junk})
        added.append(junk)
        load_entry_points.cache_clear()

    def read() -> None:
        good[chosen[0]][1]()
        formats.describe_formats()
        formats.make_dialog_filter()
        list_sensor_names()

    try_all(read, make, 2.0)
    load_entry_points.cache_clear()
