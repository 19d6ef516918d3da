"""`tactoscope live`: a sensor on the terminal."""

from __future__ import annotations

import math
import os
import threading
import time
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.cli.stopping import asking
from pipeline.cli.terminal import print_line
from pipeline.live import zero
from pipeline.live.device import found
from pipeline.live.reader import Reader
from pipeline.live.recorder import Recorder
from pipeline.live.source import Source

_EVERY_S = 1.0
_PATIENCE_S = 5.0  # for the reader's thread to end


def list_cameras() -> int:
    """Print the cameras that are plugged in; returns 0."""
    cameras = found()
    for camera in cameras:
        print_line(f"{camera.name}  {camera.kind.sensor or 'no known sensor'}  {os.fspath(camera.node)}")
    if not cameras:
        print_line("no camera is plugged in")
    return 0


def watch(source: Source, record: Path | None, seconds: float) -> int:
    """Watch until the time is over or Ctrl-C; returns 0, 1 if nothing came at all."""
    if not 0.0 <= seconds < math.inf:
        raise SettingProblem(f"--seconds must be 0 or more, got {seconds:g}")
    recorder = None if record is None else Recorder(record, source.title)
    reader, ended = Reader(source), threading.Event()
    if recorder is not None:
        reader.listen(recorder.offer)
    began_s = time.monotonic()
    try:
        with asking(lambda *_: ended.set()):
            reader.start()
            while not ended.wait(_EVERY_S) and (seconds <= 0 or time.monotonic() - began_s < seconds):
                _say(reader, recorder)
    finally:
        reader.listen(None)
        reader.stop(_PATIENCE_S)
        if recorder is not None:
            recorder.close()
    return _result(reader, recorder)


def _say(reader: Reader, recorder: Recorder | None) -> None:
    status = reader.status()
    written = "" if recorder is None else f", {recorder.n_written} recorded"
    sentence = status.sentence or ("" if recorder is None else recorder.problem)
    wrong = f"; {sentence}" if sentence else ""
    print_line(
        f"{status.state}: {status.rate_hz:.1f} Hz, {status.n_frames} frames, {status.n_lost} lost{written}"
        f"{'' if reader.has_zero else ', no zero yet'}{wrong}"
    )


def _result(reader: Reader, recorder: Recorder | None) -> int:
    status = reader.status()
    if not status.n_frames:
        print_line(f"nothing came from {reader.source.title}{f': {status.sentence}' if status.sentence else ''}")
        return 1
    if recorder is None:
        return 0
    if recorder.n_written:
        print_line(f"{recorder.n_written} frames in {os.fspath(recorder.path)}, {recorder.n_left_out} left out")
    elif not recorder.problem:
        print_line(
            f"nothing was recorded and no file is left: the first {zero.FIRST} readings are taken as untouched, "
            f"{status.n_frames} came; let it watch for longer"
        )
        return 1
    if recorder.problem:
        print_line(recorder.problem)
    return 2 if recorder.problem else 0
