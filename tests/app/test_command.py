"""`tactoscope view` as it is typed where it cannot work, and an interrupted command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

SCRIPT = Path(sys.executable).with_name("tactoscope")
SAMPLE = Path(__file__).parents[2] / "sample_data" / "recordings" / "first_touch.h5"


def test_without_a_display_the_window_is_refused():
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    nowhere = {k: v for k, v in os.environ.items() if k not in screens}
    done = subprocess.run(
        [SCRIPT, "view"], env=nowhere, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("tactoscope: no display")
    assert len(done.stderr.splitlines()) == 1


def test_an_interrupted_translation_leaves_complete_frames(tmp_path):
    out = tmp_path / "out"
    command = [
        SCRIPT,
        "translate",
        SAMPLE,
        "--sensor",
        "gelslim",
        "--target",
        "digit",
        "--all",
        "--out",
        out,
    ]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    ) as running:
        try:
            while not list(out.glob("frame_*")) and running.poll() is None:
                time.sleep(0.02)
            running.send_signal(signal.SIGINT)
            _, said = running.communicate()
        finally:
            running.kill()  # one that did not end
    assert running.returncode == 130
    assert "interrupted; finished frames are complete" in said
    assert "Traceback" not in said
    assert (out / "report.json").is_file()
    assert not list(out.glob(".*"))
    assert all(
        (f / "stages.npz").is_file() and (f / "sheet.png").is_file() for f in out.glob("frame_*")
    )
