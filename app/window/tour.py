"""The tour: steps through the recording by itself and leaves the window's picture and every stage behind."""

from __future__ import annotations

import time
from pathlib import Path

from PyQt6.QtCore import QCoreApplication, QEventLoop

from app.window.screenshots import write_screenshot
from app.window.session_controller import SessionController
from pipeline.cli.terminal import print_line
from pipeline.cli.translate import print_stage_table
from pipeline.reporting.frame_report import FrameReport
from pipeline.reporting.report import write_frame, write_report

FRAME_TIMEOUT_S = 120.0  # a frame that takes longer has hung
_BREATH_MS = 20


def run_tour(instrument: SessionController, out: Path, *, show_frame: int | None = None) -> int:
    """Show every frame, write `window.png`, `frame_NNNN/` and `report.json` under `out`, print the table.

    Returns 0, or 2 if some frame could not be shown; the picture shows `show_frame`, by default the deepest touch.
    """
    if not wait_until_shown(instrument) or instrument.views.translation is None:
        print_line(f"the recording could not be shown: {instrument.window.banner.text}")
        return 2
    translation = instrument.views.translation
    reports: list[FrameReport] = []
    felt_px: dict[int, int] = {}
    for index in range(translation.n_frames):
        instrument.choose_frame(index)
        shown = wait_until_shown(instrument)
        if instrument.is_closed:
            print_line(f"the window was closed; {index} of {translation.n_frames} frames are whole in {out}")
            return 2
        latest = instrument.latest_frame
        if not shown or latest is None or latest.index != index:
            problem = instrument.window.banner.text or "not shown in time"
            reports.append(FrameReport(index=index, results={}, metrics={}, problem=problem))
            continue
        report = FrameReport(index=index, results=latest.results, metrics=latest.metrics)
        reports.append(report.without_arrays)
        felt_px[index] = int(latest.results["depth"].output.contact.sum())
        write_frame(out, latest.frame, report, translation)
    write_report(out, translation, reports)
    instrument.choose_frame(max(felt_px, key=felt_px.__getitem__, default=0) if show_frame is None else show_frame)
    wait_until_shown(instrument)
    pin_deepest_pixel(instrument)
    save_window_screenshot(instrument, out / "window.png")
    print_stage_table(reports)
    failed = [frame for frame in reports if frame.problem]
    for frame in failed:
        print_line(f"frame {frame.index}: {frame.problem}")
    print_line(f"{len(reports) - len(failed)} of {len(reports)} frames shown and written to {out}")
    return 2 if failed else 0


def wait_until_shown(instrument: SessionController, limit_s: float = FRAME_TIMEOUT_S) -> bool:
    """Let the window work until everything asked for is on screen; False if that takes too long or failed."""
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        QCoreApplication.processEvents(QEventLoop.ProcessEventsFlag.AllEvents, _BREATH_MS)
        if instrument.is_closed:
            return False
        if instrument.is_idle:
            QCoreApplication.processEvents()
            return not instrument.window.banner.isVisible()
        time.sleep(0.001)
    return False


def save_window_screenshot(instrument: SessionController, path: Path) -> None:
    """Write the window as it stands, 3D views included."""
    instrument.views.scene.draw_pending()
    for _ in range(3):  # layouts, then paints, then what the paints asked for
        QCoreApplication.processEvents(QEventLoop.ProcessEventsFlag.AllEvents, _BREATH_MS)
    write_screenshot(instrument.window, path)


def pin_deepest_pixel(instrument: SessionController) -> None:
    """Pin the target pixel that is pushed in deepest, so that the picture shows a trace."""
    project = instrument.latest_frame.results.get("target_depth") if instrument.latest_frame is not None else None
    if project is not None and project.output.contact.any():
        view = project.output
        row, col = divmod(int(view.indentation_mm.argmax()), view.camera.cols)
        instrument.probe.toggle_pin("target_depth", row, col)
        instrument.probe.draw_pending()
