"""The tour: shows every frame, and writes a screenshot and every stage."""

import time
from pathlib import Path

from PyQt6.QtCore import QCoreApplication, QEventLoop

from app.document.session_controller import SessionController
from app.window.screenshots import write_screenshot
from pipeline.cli.terminal import print_line

FRAME_TIMEOUT_S = 120.0  # per frame
_EVENTS_MS = 20


def run_tour(controller: SessionController, out: Path, *, show_frame: int | None = None) -> int:
    """Show every frame, write `window.png`, `frame_NNNN/` and `report.json` under `out`, print the
    table.

    Returns 0, or 2 if a frame failed. The screenshot shows `show_frame`, by default the frame with
    most contact.
    """
    from pipeline.cli.translate import print_stage_table
    from pipeline.translation.reports.report import write_frame, write_report
    from pipeline.translation.translated_frame import FrameReport

    if not wait_until_shown(controller) or controller.views.translation is None:
        print_line(f"the recording could not be shown: {controller.window.banner.text}")
        return 2
    translation = controller.views.translation
    n_frames = translation.n_frames
    reports: list[FrameReport] = []
    contact_px: dict[int, int] = {}
    for index in range(n_frames):
        controller.choose_frame(index)
        shown = wait_until_shown(controller)
        if controller.is_closed:
            print_line(f"the window was closed; {index} of {n_frames} frames are complete in {out}")
            return 2
        latest = controller.latest_frame
        if shown and latest is not None and latest.index == index:
            report = FrameReport(index=index, results=latest.results, metrics=latest.metrics)
            contact_px[index] = int(latest.results["depth"].output.contact.sum())
            write_frame(out, latest.frame, report, translation)
        else:
            problem = controller.window.banner.text or "not shown in time"
            report = FrameReport(index=index, results={}, metrics={}, problem=problem)
            print_line(f"frame {index}: {problem}")
        reports.append(report.without_arrays)
    write_report(out, translation, reports)
    most = max(contact_px, key=contact_px.__getitem__, default=0)
    controller.choose_frame(most if show_frame is None else show_frame)
    wait_until_shown(controller)
    pin_deepest_pixel(controller)
    save_window_screenshot(controller, out / "window.png")
    print_stage_table(reports)
    print_line(f"{len(contact_px)} of {n_frames} frames shown and written to {out}")
    return 0 if len(contact_px) == n_frames else 2


def wait_until_shown(controller: SessionController, limit_s: float = FRAME_TIMEOUT_S) -> bool:
    """Process events until everything requested is on screen; False after an error or `limit_s`."""
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        QCoreApplication.processEvents(QEventLoop.ProcessEventsFlag.AllEvents, _EVENTS_MS)
        if controller.is_closed:
            return False
        if controller.is_idle:
            QCoreApplication.processEvents()
            return not controller.window.banner.isVisible()
        time.sleep(0.001)
    return False


def save_window_screenshot(controller: SessionController, path: Path) -> None:
    """Write an image of the window, including the 3D views."""
    controller.views.scene.draw_pending()
    for _ in range(3):  # layout, paint, and updates requested by painting
        QCoreApplication.processEvents(QEventLoop.ProcessEventsFlag.AllEvents, _EVENTS_MS)
    write_screenshot(controller.window, path)


def pin_deepest_pixel(controller: SessionController) -> None:
    """Pin the target pixel with the deepest indentation."""
    latest = controller.latest_frame
    stage = None if latest is None else latest.results.get("target_depth")
    if stage is not None and stage.output.contact.any():
        depth = stage.output
        row, col = divmod(int(depth.indentation_mm.argmax()), depth.camera.cols)
        controller.probe.toggle_pin("target_depth", row, col)
        controller.probe.draw_pending()
