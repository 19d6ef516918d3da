"""`tactoscope live`: a sensor on the terminal."""

from __future__ import annotations

import math
import os
import threading
import time
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.cli.interrupts import handle_interrupts
from pipeline.cli.terminal import print_line
from pipeline.live import reference_capture
from pipeline.live.reader import LiveReader
from pipeline.live.recorder import LiveRecorder
from pipeline.live.source import LiveSource
from pipeline.live.usb_camera import list_usb_cameras

_EVERY_S = 1.0
_PATIENCE_S = 5.0  # for the reader's thread to end


def list_cameras() -> int:
    """Print the cameras that are plugged in; returns 0."""
    cameras = list_usb_cameras()
    for camera in cameras:
        print_line(f"{camera.name}  {camera.profile.sensor or 'no known sensor'}  {os.fspath(camera.node)}")
    if not cameras:
        print_line("no camera is plugged in")
    return 0


def watch_sensor(source: LiveSource, record: Path | None, seconds: float) -> int:
    """Watch until the time is over or Ctrl-C; returns 0, 1 if nothing came at all."""
    if not 0.0 <= seconds < math.inf:
        raise SettingProblem(f"--seconds must be 0 or more, got {seconds:g}")
    recorder = None if record is None else LiveRecorder(record, source.title)
    reader, ended = LiveReader(source), threading.Event()
    if recorder is not None:
        reader.set_listener(recorder.offer)
    began_s = time.monotonic()
    try:
        with handle_interrupts(lambda *_: ended.set()):
            reader.start()
            while not ended.wait(_EVERY_S) and (seconds <= 0 or time.monotonic() - began_s < seconds):
                _say(reader, recorder)
    finally:
        reader.set_listener(None)
        reader.stop(_PATIENCE_S)
        if recorder is not None:
            recorder.close()
    return _result(reader, recorder)


def _say(reader: LiveReader, recorder: LiveRecorder | None) -> None:
    status = reader.status()
    written = "" if recorder is None else f", {recorder.n_written} recorded"
    sentence = status.message or ("" if recorder is None else recorder.problem)
    wrong = f"; {sentence}" if sentence else ""
    print_line(
        f"{status.state}: {status.rate_hz:.1f} Hz, {status.n_frames} frames, {status.n_lost} lost{written}"
        f"{'' if reader.has_reference else ', no zero yet'}{wrong}"
    )


def _result(reader: LiveReader, recorder: LiveRecorder | None) -> int:
    status = reader.status()
    if not status.n_frames:
        print_line(f"nothing came from {reader.source.title}{f': {status.message}' if status.message else ''}")
        return 1
    if recorder is None:
        return 0
    if recorder.n_written:
        print_line(f"{recorder.n_written} frames in {os.fspath(recorder.path)}, {recorder.n_dropped} left out")
    elif not recorder.problem:
        print_line(
            f"nothing was recorded and no file is left: the first {reference_capture.AUTO_CAPTURE_FRAMES} readings are taken as untouched, "
            f"{status.n_frames} came; let it watch for longer"
        )
        return 1
    if recorder.problem:
        print_line(recorder.problem)
    return 2 if recorder.problem else 0
