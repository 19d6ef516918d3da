"""`tactoscope live`: a sensor on the terminal."""

import math
import os
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Annotated

from cyclopts import Parameter

from pipeline.cli.terminal import handle_interrupts, print_line
from pipeline.core.errors import SettingProblem
from pipeline.core.params import check_range
from pipeline.io.live import reference_capture
from pipeline.io.live.paired_reader import make_reader
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.recorder import LiveRecorder
from pipeline.io.live.source_parsing import RATE_RANGE_HZ, parse_sources
from pipeline.io.live.usb_camera import list_usb_cameras
from pipeline.io.mounts import mount, unmount
from pipeline.sensors.spec import load_sensor
from pipeline.stages.metrics.stage_metrics import describe_metric
from pipeline.translation.live_translation import LIVE, LiveResult, LiveTranslation
from pipeline.translation.translate import Request, open_translation

_STATUS_PERIOD_S = 1.0
_POLL_S = 0.05  # between looks at the clock and at Ctrl-C
_SIMULATED_RATE_HZ = 15.0  # of a simulated sensor where best quality is wanted
_STOP_TIMEOUT_S = 5.0  # for the reader's thread to end
# of the generated touch, against what the partner took
_SHOWN_METRICS = ("touch.psnr_db", "touch.depth_mae_mm")


def live(
    *,
    source: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative="")] = (
        "simulated",
    ),
    sensor: str = "",
    partner: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative="")] = (),
    partner_sensor: str = "",
    object_source: Annotated[str, Parameter(name="--object")] = "sphere",
    target: str = "",
    route: str = "t2d2",
    rate: float = 15.0,
    record: Path | None = None,
    seconds: float = 0.0,
    list_devices: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Print a sensor's status every second, and translate it on all cores; returns the exit code.

    Args:
        source: `simulated`, `folder DIR` into which another program writes images, `device NAME`: a
            part of a camera's name or serial number, or the path of a camera or of a recorded
            stream, `camera:0` by number, `http://...` or `rtsp://...`: a video stream of a network,
            `realsense` with a serial number where there are several: the depth camera of a bubble,
            or `ws://HOST:PORT TOPIC`: images or depth that a Foxglove bridge (ROS 1 and 2)
            publishes.
        sensor: Sensor type, if neither device name nor image size identifies it; for `simulated`
            the sensor to simulate.
        partner: Second sensor that touches the same object, named as the source is: the other
            finger, or the target's own sensor, whose images are then compared with the generated
            ones. Its frames are paired by time, and recorded too.
        partner_sensor: Sensor type of the partner. Default: that of `--target`.
        object_source: Object pressed into a simulated sensor: an object of `tactoscope simulate`,
            or a mesh file.
        target: Sensor to translate to; the status then says how many frames a second are
            translated, and how old they are when they are. Default: no translation.
        route: Route through the stages.
        rate: Frames per second of a simulated sensor, and to translate: what cannot be computed in
            time is left out, and said. 0 = best quality: nothing is left out of a frame.
        record: Recording to write, an .h5 file that is readable while it grows and after a crash.
        seconds: Stop after this time; 0 = at Ctrl-C.
        list_devices: Only list the connected cameras.
    """
    if list_devices:
        return _list_cameras()
    if rate:
        check_range("--rate", rate, *RATE_RANGE_HZ, "Hz")
    if target:
        load_sensor(target)  # a wrong name is said before anything starts
    sources = parse_sources(
        source,
        partner,
        sensor=sensor,
        partner_sensor=partner_sensor,
        target=target,
        tool=object_source,
        rate_hz=rate or _SIMULATED_RATE_HZ,
    )
    request = Request(recording=LIVE, target=target, route=route) if target else None
    return _watch_sensor(make_reader(*sources), record, seconds, request, rate)


def _list_cameras() -> int:
    cameras = list_usb_cameras()
    for camera in cameras:
        print_line(
            f"{camera.name}  {camera.profile.sensor or 'no known sensor'}  {os.fspath(camera.node)}"
        )
    if not cameras:
        print_line("no camera is connected")
    return 0


def _watch_sensor(
    reader: LiveReader,
    record: Path | None,
    seconds: float,
    request: Request | None,
    rate_hz: float,
) -> int:
    """Print the status until the time is over or Ctrl-C; returns 1 if no frame came."""
    if not 0.0 <= seconds < math.inf:
        raise SettingProblem(f"--seconds must be 0 or more, got {seconds:g}")
    recorder = None if record is None else LiveRecorder(record, reader)
    ended = threading.Event()
    live: LiveTranslation | None = None
    shown: list[LiveResult] = []
    has_shown = False
    start_s = said_s = time.monotonic()
    mount(LIVE, lambda: reader.make_recording(LIVE))
    try:
        with handle_interrupts(lambda *_: ended.set()):
            reader.start()
            while not ended.is_set() and (seconds <= 0 or time.monotonic() - start_s < seconds):
                if request is not None and live is None and reader.has_reference:
                    live = LiveTranslation(open_translation(request), reader, rate_hz=rate_hz)
                if live is None:
                    ended.wait(_POLL_S)
                else:
                    shown += live.poll(_POLL_S)
                    has_shown = has_shown or bool(shown)
                now_s = time.monotonic()
                if now_s - said_s >= _STATUS_PERIOD_S:
                    translated = ""
                    if live is not None:
                        translated = (
                            _describe(live, shown, now_s - said_s)
                            if has_shown or live.problem
                            else "the processes that translate are starting"
                        )
                    _print_status(reader, recorder, translated)
                    shown, said_s = [], now_s
    finally:
        unmount(LIVE)
        if live is not None:
            live.close()
        reader.stop(_STOP_TIMEOUT_S)
        if recorder is not None:
            recorder.close()
    return _print_result(reader, recorder)


def _describe(live: LiveTranslation, shown: Sequence[LiveResult], period_s: float) -> str:
    """How many frames a second were translated, how old they were, and what was left out."""
    ages_ms = sorted(1e3 * one.age_s for one in shown)
    aim = f" of {live.plan.rate_hz:g}" if live.plan.rate_hz else ""
    parts = (
        f"{len(shown) / period_s:.1f}{aim} Hz translated",
        f"{ages_ms[len(ages_ms) // 2]:.0f} ms old, at most {ages_ms[-1]:.0f}" if shown else "",
        _describe_metrics(shown),
        live.plan.describe(),
        live.problem,
    )
    return ", ".join(part for part in parts if part)


def _describe_metrics(shown: Sequence[LiveResult]) -> str:
    """Medians of the errors of the generated touch against the partner's image."""
    compared = [one.metrics for one in shown if one.truth.target_observation is not None]
    values = {name: [m[name] for m in compared if name in m] for name in _SHOWN_METRICS}
    return ", ".join(
        f"{describe_metric(name)} {median(found):.3g}" for name, found in values.items() if found
    )


def _print_status(reader: LiveReader, recorder: LiveRecorder | None, translated: str) -> None:
    status = reader.status()
    parts = [status.describe()]
    if recorder is not None:
        parts.append(f"{recorder.n_written} recorded, {recorder.n_dropped} left out")
    if not reader.has_reference:
        parts.append("no reference yet")
    problem = status.message or (recorder.problem if recorder else "")
    print_line("; ".join(filter(None, (", ".join(parts), translated, problem))))


def _print_result(reader: LiveReader, recorder: LiveRecorder | None) -> int:
    status = reader.status()
    if not status.n_frames:
        print_line(
            f"no frame came from {reader.title}{f': {status.message}' if status.message else ''}"
        )
        return 1
    if recorder is None:
        return 0
    if recorder.n_written:
        # also those that came before the reference or after a problem
        n_frames = status.n_frames + (status.partner.n_frames if status.partner else 0)
        left_out = n_frames - recorder.n_written
        print_line(
            f"{recorder.n_written} of {n_frames} frames in {os.fspath(recorder.path)}, "
            f"{left_out} left out"
        )
    elif not recorder.problem:
        why = status.message or (
            f"the first {reference_capture.AUTO_CAPTURE_FRAMES} frames make the reference, "
            f"{status.n_frames} came; record for longer"
        )
        print_line(f"nothing was recorded and no file is left: {why}")
        return 1
    if recorder.problem:
        print_line(recorder.problem)
    return 2 if recorder.problem else 0
