"""The same results, or one sentence, wherever the program is started."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from pipeline.io.live.source_parsing import FolderSource

ROOT = Path(__file__).parents[2]
_NO_HOME = """
import pwd, sys
def unknown(uid):
    raise KeyError(uid)
pwd.getpwuid = unknown
from pipeline.cli.main import build_app, run_app
sys.exit(run_app(build_app(), sys.argv[1:]))
"""
_FIGURE = """
import sys
from pipeline.core.figures import make_figure
figure = make_figure(figsize=(2, 2), dpi=50)
figure.add_subplot().plot([0, 1], [0, 1])
figure.savefig(sys.argv[1], metadata={"Software": None})
"""
_LOCALE = """
import locale
from app.main import prepare_environment
prepare_environment()
from app.main import make_application
application = make_application()
print(locale.setlocale(locale.LC_NUMERIC))
"""


def run(
    folder: Path, code: str, *words: object, **environment: str
) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *map(str, words)]
    variables = {"PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"], **environment}
    return subprocess.run(
        command, cwd=folder, env=variables, capture_output=True, text=True, timeout=240, check=False
    )


def test_a_user_without_a_home_gets_results_and_doctor_says_what_is_missing(tmp_path):
    done = run(tmp_path, _NO_HOME, "inspect", ROOT / "sample_data" / "recordings" / "no_contact.h5")
    assert "Traceback" not in done.stderr
    assert "RuntimeError" not in done.stderr
    assert "gelslim" in done.stdout
    assert list(tmp_path.iterdir()) == []  # no folder called "~"
    done = run(tmp_path, _NO_HOME, "doctor")
    assert done.returncode == 1
    assert "MISSING  a home folder" in done.stdout


def test_a_matplotlibrc_in_the_folder_changes_no_picture(tmp_path):
    pictures = []
    for name, content in (
        ("a", b""),
        ("b", b"axes.facecolor: red\nlines.linewidth: 9\nno such key: 1\n"),
        ("c", b"\xff\xfe"),
    ):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "matplotlibrc").write_bytes(content)
        done = run(folder, _FIGURE, folder / "a.png", HOME=str(tmp_path))
        if name == "c":
            assert "is no text; rename it" in done.stderr
        else:
            pictures.append((folder / "a.png").read_bytes())
    assert pictures[0] == pictures[1]


def test_numbers_have_a_point_after_qt_has_started(tmp_path):
    done = run(tmp_path, _LOCALE, LC_ALL="C.UTF-8", QT_QPA_PLATFORM="offscreen", HOME=str(tmp_path))
    assert done.stdout.splitlines()[-1:] == ["C"], done.stderr


def test_a_look_at_a_growing_folder_costs_nothing_for_the_images_before(tmp_path, monkeypatch):
    import cv2

    for index in range(300):
        (tmp_path / f"{index}.png").touch()
    source = FolderSource(tmp_path, sensor="digit")
    source.open()
    cv2.imwrite(str(tmp_path / "new.png"), np.full((320, 240, 3), 90, np.uint8))
    looked = []
    monkeypatch.setattr(
        "pipeline.io.image_files.is_image_file", lambda path: looked.append(path.name) or True
    )
    assert source.read() is not None
    assert looked == ["new.png"]
