"""`tactoscope export --to`: what Rerun's and MCAP's own readers find in the files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.cli.main import build_app, run_app
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.translation.reports.viewer_files import write_mcap, write_rrd
from pipeline.translation.translate import Request, open_translation

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
FRAMES = (0, 8)
PANES = ("source", "depth", "cloud", "target_depth", "touch", "touch_depth", "pose")


def export(path: Path) -> Path:
    words = [
        "export",
        str(SAMPLE),
        "--target",
        "soft_bubble",
        "--sensor",
        "gelslim",
        "--method",
        "touch=physics",
    ]
    assert (
        run_app(build_app(), [*words, "--frames", ",".join(map(str, FRAMES)), "--to", str(path)])
        == 0
    )
    return path


@pytest.fixture(scope="module")
def evaluated():
    translation = open_translation(
        Request(
            recording=SAMPLE,
            target="soft_bubble",
            source="gelslim",
            methods=(("touch", "physics"),),
        )
    )
    yield translation, translation.evaluate(8)
    translation.close()


def test_rerun_reads_all_stages_on_one_time_line(tmp_path, evaluated):
    translation, results = evaluated
    rr = pytest.importorskip("rerun")
    chunks = rr.chunk.RrdReader(export(tmp_path / "a.rrd")).stream().to_chunks()
    entities = {chunk.entity_path.strip("/") for chunk in chunks}
    assert {f"{pane}/{kind}" for pane in PANES for kind in ("image", "points")} | {
        "object"
    } <= entities
    clouds = [c.to_record_batch() for c in chunks if c.entity_path.strip("/") == "cloud/points"]
    frames = {int(n) for batch in clouds for n in batch.column("frame").to_pylist()}
    assert frames == set(FRAMES)
    rows = [batch.column("Points3D:positions").to_pylist() for batch in clouds]
    last = np.array(rows[-1][-1])
    np.testing.assert_allclose(1e3 * last, results["cloud"].output.points_mm, atol=1e-4)
    assert translation.mesh is not None
    assert any(chunk.is_static and chunk.entity_path.strip("/") == "object" for chunk in chunks)


def test_mcap_holds_images_depth_points_and_pose(tmp_path, evaluated):
    _, results = evaluated
    reader = pytest.importorskip("mcap.reader")
    from mcap_protobuf.decoder import DecoderFactory

    with export(tmp_path / "a.mcap").open("rb") as file:
        messages = list(
            reader.make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        )
    topics = {channel.topic: schema.name for schema, channel, _, _ in messages}
    assert {f"/{pane}/image" for pane in PANES} <= topics.keys()
    assert topics["/depth/depth"] == "foxglove.RawImage"
    assert topics["/cloud/points"] == "foxglove.PointCloud"
    last = {channel.topic: (message, decoded) for _, channel, message, decoded in messages}
    assert last["/depth/depth"][0].sequence == FRAMES[-1]
    depth = last["/depth/depth"][1]
    depth_m = np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width)
    np.testing.assert_allclose(1e3 * depth_m, results["depth"].output.depth_mm, rtol=1e-5)
    cloud = np.frombuffer(last["/cloud/points"][1].data, [("xyz", "<f4", 3), ("rest", "u1", 4)])
    np.testing.assert_allclose(1e3 * cloud["xyz"], results["cloud"].output.points_mm, atol=1e-4)
    position = last["/object"][1].pose.position
    pose = results["pose"].output.sensor_from_object
    np.testing.assert_allclose(
        [1e3 * position.x, 1e3 * position.y, 1e3 * position.z], pose[:3, 3], atol=1e-6
    )


def test_a_disk_that_is_full_is_named(tmp_path, monkeypatch):
    rr = pytest.importorskip("rerun")

    def flush(*_, **__):
        raise RuntimeError("File-writer thread shut down prematurely")

    monkeypatch.setattr(rr.RecordingStream, "flush", flush)
    with pytest.raises(FileProblem, match=r"no room for it in .*a\.rrd"):
        write_rrd(tmp_path / "a.rrd", (), None)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("write", "module"), [(write_rrd, "rerun"), (write_mcap, "mcap_protobuf.writer")]
)
def test_a_missing_package_is_named(tmp_path, monkeypatch, write, module):
    monkeypatch.setitem(sys.modules, module, None)
    path = tmp_path / "a.x"
    with pytest.raises(SettingProblem, match="pip install"):
        write(path, (), *((None,) if write is write_rrd else ()))
    assert not path.exists()
