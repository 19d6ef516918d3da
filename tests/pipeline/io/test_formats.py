"""The table of formats: dialogs and help follow from it, and another package adds a format or a
sensor.
"""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import numpy as np
import pytest

from pipeline.core import entry_points
from pipeline.core.errors import FileProblem
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io import formats, open_recording
from pipeline.io.formats import FORMATS, RecordingFormat
from pipeline.sensors import descriptions
from pipeline.sensors.spec import list_sensor_names, load_sensor

DEPTH_MM = np.arange(12, dtype=np.float32).reshape(3, 4) + 80.0


def read_text_depth(path: Path) -> Recording:
    """A reader of another package: one depth image as text."""
    image = np.loadtxt(path, np.float32)
    frame = TactileFrame(sensor="soft_bubble", image=image, reference=None)
    stream = Stream(name="text", sensor="soft_bubble", n_frames=1, frame=lambda _: frame)
    return Recording(path=path, format="text", streams=(stream,))


TEXT_DEPTH = RecordingFormat(
    key="text_depth",
    title="Text depth",
    suffixes=(".depth",),
    reader=f"{__name__}:read_text_depth",
)
BROKEN = "no.such.module:FORMAT"


@pytest.fixture
def add_entry_points(monkeypatch):
    """Entry points of another package, as `importlib.metadata` lists them."""
    entry_points.load_entry_points.cache_clear()
    added: list[importlib.metadata.EntryPoint] = []
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: [e for e in added if e.group == group]
    )
    yield lambda *points: added.extend(
        importlib.metadata.EntryPoint(name="lab", value=v, group=g) for g, v in points
    )
    entry_points.load_entry_points.cache_clear()


@pytest.fixture
def text_file(tmp_path: Path) -> Path:
    np.savetxt(tmp_path / "touch.depth", DEPTH_MM)
    return tmp_path / "touch.depth"


@pytest.mark.parametrize("by", ["entry point", "registration"])
def test_another_package_adds_a_format(text_file: Path, by: str, add_entry_points, monkeypatch):
    with pytest.raises(FileProblem, match="unknown kind"):
        open_recording(text_file)
    if by == "entry point":
        entry_points.load_entry_points.cache_clear()
        add_entry_points(("tactoscope.formats", f"{__name__}:TEXT_DEPTH"))
    else:
        monkeypatch.setattr(formats, "_registered", [])
        formats.register_format(TEXT_DEPTH)
    for path in (text_file, text_file.parent):  # by name, and in a folder
        np.testing.assert_array_equal(open_recording(path).streams[0].frame(0).image, DEPTH_MM)
    assert "Text depth (*.depth)" in formats.make_dialog_filter()
    assert "Text depth (.depth)" in formats.describe_formats()


def test_an_entry_point_that_cannot_be_loaded_is_left_out_with_a_warning(add_entry_points, caplog):
    add_entry_points(("tactoscope.formats", BROKEN))
    assert formats.list_formats() == FORMATS
    assert BROKEN in caplog.text


@pytest.mark.parametrize("by", ["entry point", "registration"])
def test_another_package_adds_a_sensor(tmp_path: Path, by: str, add_entry_points, monkeypatch):
    (tmp_path / "lab_gel.toml").write_text('extends = "digit"\ntitle = "Lab gel"\n')
    (tmp_path / "digit.toml").write_text('extends = "gelslim"\n')  # cannot replace the project's
    if by == "entry point":
        monkeypatch.setitem(globals(), "FOLDER", tmp_path)
        add_entry_points(("tactoscope.sensors", f"{__name__}:FOLDER"))
    else:
        monkeypatch.setattr(descriptions, "_registered", [])
        descriptions.register_sensors(tmp_path)
    assert "lab_gel" in list_sensor_names()
    assert load_sensor("lab_gel").title == "Lab gel"
    assert load_sensor("digit").title == "DIGIT"


def test_every_format_names_functions_that_exist_and_keys_are_unique():
    for one in FORMATS:
        for reference in filter(None, (one.reader, one.matches, one.folder)):
            assert callable(entry_points.load_reference(reference))
    assert len({one.key for one in FORMATS}) == len(FORMATS)
