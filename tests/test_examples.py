"""Every example runs as it stands, on the sample recordings, and does what it says."""

from __future__ import annotations

import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

import tactoscope as ts

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
MOST_LINES = 25


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """A folder with the sample recordings, in which an example may write."""
    (tmp_path / "sample_data").symlink_to(ROOT / "sample_data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pipeline.io.formats._registered", [])
    return tmp_path


def run(name):
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")


def test_own_arrays():
    ran = run("own_arrays")
    assert ran["depth"].contact.any()
    assert [image.shape for image in ran["generated"]] == [
        (*ts.load_sensor("gelslim").camera.shape, 3)
    ] * 2


def test_folder(place):
    with pytest.raises(SystemExit, match="put images of a DIGIT into the folder 'touches' first"):
        run("folder")
    stream = ts.open_recording(ROOT / "sample_data/recordings/first_touch.h5").stream("digit")
    (place / "touches").mkdir()
    for name, image in (
        ("reference", stream.frame(5).reference),
        ("touch_0", stream.frame(5).image),
    ):
        cv2.imwrite(str(place / "touches" / f"{name}.png"), image[..., ::-1])
    assert run("folder")["written"] == 1
    assert cv2.imread("touches_0000.png").shape == (*ts.load_sensor("gelslim").camera.shape, 3)
    exec((EXAMPLES / "folder.py").read_text().replace("gelslim", "soft_bubble"), {})
    image = cv2.imread("touches_0000.png")
    assert image.shape == (*ts.load_sensor("soft_bubble").camera.shape, 3)
    assert len(np.unique(image)) > 20, "shades, where millimetres have few"


def test_sweep_guidance():
    assert len(set(run("sweep_guidance")["errors_mm"].values())) == 4


def test_align_sensors():
    before, after = run("align_sensors")["fit"].used_fit
    assert after.surface_mm < before.surface_mm


def test_calibrate(place):
    ran = run("calibrate")
    assert (place / "digit.npz").is_file()
    assert sum(press.used for press in ran["table"].presses) >= 3
    assert any("6 presses" in note for note in ran["depth"].notes)  # too few, and the table says so


def test_track():
    assert run("track")["record"].count("tracked") == 6


def test_own_method(capsys):
    run("own_method")
    loose, strict = (int(line.split()[2]) for line in capsys.readouterr().out.splitlines())
    assert 0 < strict < loose


def test_own_sensor():
    ran = run("own_sensor")
    assert ran["touches"].target.gel.thickness_mm == 1.5
    assert ran["sensor"].camera.shape == (480, 640)


def test_own_format():
    touches = run("own_format")["touches"]
    assert (len(touches), touches.recording.path.name) == (1, "touch.rgb")


def test_train_on_pairs():
    ran = run("train_on_pairs")
    assert not ran["result"].fallback
    assert ran["result"].method.name == "t2t"
    again = ts.train("t2t", out="run", pairs=ran["PAIRS"], steps=2)
    assert again == ran["weights"], "who runs the script twice gets what there is"


def test_batch(place, monkeypatch):
    monkeypatch.setattr("sys.argv", ["batch.py", "4", "11"])
    rows = run("batch")["rows"]
    assert [row["frame"] for row in rows] == [4, 15]
    assert rows[0]["touch_depth.contact_mae_mm"] > 0
    lines = (place / "metrics_4.csv").read_text().splitlines()
    assert lines[0].startswith("frame,depth.")
    assert len(lines) == 3


def test_the_notebook_shows_figures():
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(EXAMPLES / "compare_methods.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=240).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = [set(output.get("data", {})) for output in outputs]
    assert any("text/html" in kinds for kinds in shown), "a frame as images"
    assert any("image/png" in kinds for kinds in shown), "a figure"
    text = "".join(output["text"] for output in outputs if output.output_type == "stream")
    assert text.count("mm in contact") >= 4


def test_there_are_twelve_short_ones():
    scripts = sorted(EXAMPLES.glob("*.py"))
    assert len(scripts) + len(list(EXAMPLES.glob("*.ipynb"))) == 12
    assert [path.name for path in scripts if len(path.read_text().splitlines()) > MOST_LINES] == []
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {path.stem for path in scripts} <= tested
    assert np.all([path.read_text().startswith('"""') for path in scripts])
