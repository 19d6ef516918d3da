"""Exports of the window and the commands that it copies leave the same bytes.

A case plays again.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import QCoreApplication
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QApplication

from app.export.export import ExportController
from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.cli.main import build_app, run_app
from pipeline.core.errors import FileProblem
from pipeline.core.params import replace_value
from pipeline.sensors.alignment import Offsets
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.depth.stage import PHYSICS
from pipeline.translation.cross_section import SectionLine
from pipeline.translation.reports.export import export_file
from pipeline.translation.reports.export_request import format_command

LIMIT_S = 240


def handing_of(controller) -> ExportController:
    return next(child for child in controller.children() if isinstance(child, ExportController))


@pytest.fixture(scope="module")
def edited(qapp):
    """The sample with a parameter, the display and the alignment moved."""
    from app.main import show_window
    from app.session.state import Session

    made = show_window(
        Session(recording=SAMPLE_RECORDING, source="digit", target="gelslim", frame=5),
        with_scene=False,
    )
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    name = next(n for n, value in vars_of(DepthParams()).items() if isinstance(value, float))
    params = replace_value(DepthParams(), name, vars_of(DepthParams())[name] * 1.01)
    display = replace_value(made.session.display, "gel_limit_mm", 1.1)
    made.change(
        "edit",
        params={PHYSICS.key: params, "display": display},
        offsets=Offsets(translation_mm=(-0.3, 1e-5, 0.0)),
    )
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    yield made
    made.close()
    made.window.close()


def vars_of(params) -> dict:
    from pipeline.core.params import list_settings

    return {name: value for name, (value, _) in list_settings(params).items()}


def wait(handing: ExportController) -> None:
    end_s = time.monotonic() + LIMIT_S
    while (
        handing.job.is_busy or "written" not in handing.notification.text.lower()
    ) and time.monotonic() < end_s:
        QCoreApplication.processEvents()
        time.sleep(0.002)
    assert "written" in handing.notification.text.lower(), handing.notification.text


@pytest.mark.parametrize(
    ("pane", "shown", "suffix", "frames"),
    [
        ("sheet", "computed", ".png", ""),
        ("target_depth", "difference", ".pdf", ""),
        ("cloud", "computed", ".ply", ""),
        ("depth", "computed", ".npz", ""),
        ("sheet", "computed", ".csv", "4-5"),
        ("depth", "truth", ".mp4", "3-5"),
    ],
)
def test_an_export_and_its_command_leave_the_same_bytes(
    edited, tmp_path, pane, shown, suffix, frames
):
    handing = handing_of(edited)
    path = tmp_path / f"window{suffix}"
    asked = handing.make_export_request(path, pane, shown, frames)
    handing.start_export(asked)
    wait(handing)
    handing.notification.buttons[0].click()
    copied = QApplication.clipboard().text()
    assert copied == format_command(asked)
    typed = shlex.split(copied.replace(str(path), str(tmp_path / f"typed{suffix}")))
    assert run_app(build_app(), typed[1:]) == 0
    assert path.read_bytes() == (tmp_path / f"typed{suffix}").read_bytes()
    assert path.stat().st_size > 200


@pytest.mark.parametrize("layout", ["look", "align"])
def test_the_command_of_a_section_writes_the_table_that_is_copied(
    edited, tmp_path, monkeypatch, qtbot, layout
):
    monkeypatch.chdir(tmp_path)
    window = edited.window
    panel = edited.window.section_panel
    window.actions_by_name[f"layout_{layout}"].trigger()
    assert wait_until_shown(edited, LIMIT_S)
    edited.set_section(SectionLine(begin_mm=(-3.25, 1.5), end_mm=(4.0, -0.01)))
    window.drawers.diagnostics.show()
    window.tabs.setCurrentWidget(panel)
    qtbot.waitUntil(panel.command.isEnabled, timeout=240_000)
    assert wait_until_shown(edited, LIMIT_S)
    qtbot.wait(60)
    panel.copy.click()
    copied = QApplication.clipboard().text()
    panel.command.click()
    options = shlex.split(QApplication.clipboard().text())
    edited.set_section(None)
    assert run_app(build_app(), options[1:]) == 0
    assert (tmp_path / "section.csv").read_text() == copied
    assert copied.startswith("along_mm,true_source_mm,true_target_mm,")
    assert ("touch_depth_mm" in copied) == (layout == "look")
    window.actions_by_name["layout_look"].trigger()
    assert wait_until_shown(edited, LIMIT_S)


@pytest.mark.parametrize(
    ("options", "fact"),
    [
        (["--section", "1", "1", "1", "1"], "longer than nothing"),
        (["--section", "0", "0", "nan", "1"], "longer"),
        (["--section", "0", "0", "1", "1", "--pane", "depth,nose"], "no pane 'nose'"),
    ],
)
def test_an_invalid_section_is_refused(tmp_path, capsys, options, fact):
    out = ["--target", "gelslim", "--out", str(tmp_path / "s.csv")]
    assert (
        run_app(build_app(), ["export", str(SAMPLE_RECORDING), "--sensor", "digit", *out, *options])
        == 2
    )
    said = capsys.readouterr().err
    assert fact in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "s.csv").exists()


def test_the_copied_command_runs_in_its_own_process(edited, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    edited.window.actions_by_name["copy_command"].trigger()
    options = shlex.split(QGuiApplication.clipboard().text())
    assert options[:2] == ["tactoscope", "export"]
    script = Path(sys.executable).with_name("tactoscope")
    done = subprocess.run([script, *options[1:]], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    shown = edited.window.look.active_stage
    assert cv2.imread(str(tmp_path / f"{shown}.png")).shape[1] > 300


def test_exported_arrays_are_those_on_screen(edited, tmp_path):
    handing = handing_of(edited)
    handing.start_export(handing.make_export_request(tmp_path / "a.npz"))
    wait(handing)
    with np.load(tmp_path / "a.npz") as arrays:
        for stage, field in (
            ("depth", "indentation_mm"),
            ("target_depth", "depth_mm"),
            ("touch", "image"),
        ):
            on_screen = getattr(edited.latest_frame.results[stage].output, field)
            assert np.array_equal(arrays[f"{stage}.{field}"], on_screen, equal_nan=True)


def test_a_repro_bundle_replays_and_reports_changes(edited, tmp_path, capsys):
    handing = handing_of(edited)
    folder = tmp_path / "worst.bundle"
    handing.start_bundle(folder, "the gel saw a part of it")
    wait(handing)
    assert run_app(build_app(), ["replay", str(folder)]) == 0
    assert "the gel saw a part of it" in capsys.readouterr().out
    expected = dict(np.load(folder / "expected.npz"))
    on_screen = edited.latest_frame.results["target_depth"].output
    assert np.allclose(expected["target_depth.indentation_mm"], on_screen.indentation_mm, atol=1e-6)
    moved = tmp_path / "moved"
    folder.rename(moved)
    said = json.loads((moved / "bundle.json").read_text())
    said["settings"] = [line for line in said["settings"] if not line.startswith("depth")] + [
        "depth.contact_mm=0.5"
    ]
    (moved / "bundle.json").write_text(json.dumps(said))
    code = run_app(build_app(), ["replay", str(moved)])
    assert code in (1, 2)
    assert code == 1 or "contact_mm" in capsys.readouterr().err


def test_an_impossible_export_is_reported(edited, tmp_path):
    for typed, options in (
        (("--out", str(tmp_path / "a.xyz")), "known are .png"),
        (("--out", str(tmp_path / "a.ply")), "a sheet is no cloud"),
        (("--pane", "nose", "--out", str(tmp_path / "a.png")), "no pane 'nose'"),
        (
            ("--pane", "cloud", "--frame", "0", "--out", str(tmp_path / "a.ply")),
            "frame 0 has no point",
        ),
        (("--frames", "1-99", "--out", str(tmp_path / "a.csv")), "no frame 99"),
    ):
        with pytest.MonkeyPatch.context() as patch:
            said: list[str] = []
            patch.setattr("pipeline.cli.main.print_error", said.append)
            assert (
                run_app(
                    build_app(),
                    [
                        "export",
                        str(SAMPLE_RECORDING),
                        "--target",
                        "gelslim",
                        "--sensor",
                        "digit",
                        *typed,
                    ],
                )
                == 2
            )
        assert options in said[0]
        assert not list(tmp_path.iterdir())


def test_a_video_that_the_codec_cannot_write_leaves_no_file(edited, tmp_path, monkeypatch):
    class Full:
        """As OpenCV on a disk without room: no word, and no frame."""

        def __init__(self, path, *_how):
            Path(path).write_bytes(bytes(48))

        def write(self, _frame): ...
        def release(self): ...
        def isOpened(self):
            return True

    monkeypatch.setattr(
        cv2, "VideoWriter", type("Writer", (Full,), {"fourcc": cv2.VideoWriter.fourcc})
    )
    asked = handing_of(edited).make_export_request(tmp_path / "a.mp4", "depth", "computed", "3-4")
    with pytest.raises(FileProblem, match="cannot write the video"):
        export_file(asked)
    assert not list(tmp_path.iterdir())
