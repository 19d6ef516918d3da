"""Starts the window: environment before Qt loads, the window, then recording and OpenGL."""

from __future__ import annotations

import gc
import locale
import logging
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from app.session.sample import SAMPLE_RECORDING
from pipeline.core.kernel_compiler import compile_in_own_process
from pipeline.core.processes import limit_arenas

if TYPE_CHECKING:
    from PyQt6.QtWidgets import QApplication

    from app.document.session_controller import SessionController
    from app.session.state import Session
    from app.window.main_window import MainWindow
    from pipeline.translation.catalogue import Catalogue
    from pipeline.translation.translate import Request

_SHOW_TIMEOUT_S = 1.0  # for the window to be on screen; a minimised one never is
# Thresholds of the garbage collector. Loading Qt, VTK and numba creates millions of lasting
# objects; with Python's defaults, collecting takes a tenth of the time to the first touch.
_GC_THRESHOLDS = 50_000, 20, 50


def open_window(
    request: Request | None, *, frame: int | None = None, tour: Path | None = None
) -> int:
    """Show the window until it is closed, or run the `tour` and close.

    Returns the exit code of the process.

    Without a request it shows the welcome page, or the sample if a frame or a tour is requested.
    `app.shell.tour` says what a tour writes.
    """
    prepare_environment()
    from app.document.preload import PreloadController
    from app.session.state import AUTO_FRAME, REQUEST_FIELDS, Session
    from app.shutdown import ShutdownHandler

    application = make_application()
    session = Session(frame=AUTO_FRAME if frame is None else frame)
    if request is not None:
        fields = {name: getattr(request, name) for name in (*REQUEST_FIELDS, "offsets")}
        chosen = {"methods": dict(request.methods), "weights": dict(request.weights)}
        session = replace(session, **fields, **chosen)
    elif SAMPLE_RECORDING.exists() and (frame is not None or tour is not None):
        session = replace(session, recording=SAMPLE_RECORDING)
    controller = show_window(session, restore=tour is None)
    shutdown = ShutdownHandler(controller)
    try:
        if tour is not None:
            from app.shell.tour import run_tour

            code = run_tour(controller, tour, show_frame=frame)
        else:
            PreloadController(controller)
            # closed while it was made: no end
            code = application.exec() if controller.window.isVisible() else 0
        return shutdown.code or code
    finally:
        shutdown.restore_signal_handlers()
        close_window(controller)


def close_window(controller: SessionController) -> None:
    """Close and destroy the window: one that outlives the application crashes the process."""
    from PyQt6 import sip

    controller.close()
    if not sip.isdeleted(controller.window):
        sip.delete(controller.window)


def prepare_environment() -> None:
    """Set garbage collector, allocator and compiler options; must run before heavy imports."""
    limit_arenas()
    compile_in_own_process()
    gc.set_threshold(*_GC_THRESHOLDS)


def make_application() -> QApplication:
    """Return the application; create it if there is none."""
    from PyQt6.QtCore import QLocale
    from PyQt6.QtWidgets import QApplication

    from app.shutdown import destroy_windows_at_exit

    destroy_windows_at_exit()
    existing = QApplication.instance()
    if isinstance(existing, QApplication):
        return existing
    application = QApplication([sys.argv[0]])
    QLocale.setDefault(QLocale.c())  # figures have a decimal point everywhere
    # Qt sets the user's: a C library would then read 0,5 and not 0.5
    locale.setlocale(locale.LC_NUMERIC, "C")
    application.setApplicationName("Tactoscope")
    return application


def show_window(
    session: Session,
    *,
    with_scene: bool = True,
    catalogue: Catalogue | None = None,
    restore: bool = False,
) -> SessionController:
    """Show a window on `session`.

    It is on screen before the recording is read and OpenGL is loaded.

    `catalogue` defaults to the built-in stages, methods and routes. `restore` uses the saved theme,
    device and geometry, and offers the session of a window that did not close normally.
    """
    from PyQt6.QtCore import QTimer
    from PyQt6.QtWidgets import QApplication

    from app.document.session_controller import SessionController
    from app.session.preferences import Preferences
    from app.shell.connections import connect
    from app.shell.themes import apply_theme
    from app.window.main_window import MainWindow
    from pipeline.lab.tasks.trial_rows import is_rollout_folder
    from pipeline.lab.tracking.track_record import is_track_folder
    from pipeline.stages.networks.devices import AUTO
    from pipeline.translation.catalogue import BUILT_IN
    from pipeline.translation.reports.folder_overview import list_recordings
    from widgets.style.base import set_text_size
    from widgets.style.plain_text_style import PlainTextStyle

    if not isinstance(QApplication.style(), PlainTextStyle):
        QApplication.setStyle(PlainTextStyle())
    set_text_size()
    preferences = Preferences()
    theme = preferences.theme if restore else "dark"
    if restore and session.device == AUTO:
        session = session.with_device(preferences.device)
    apply_theme(theme)
    catalogue = catalogue or BUILT_IN
    titles = {stage.name: stage.title for stage in catalogue.stages}
    window = MainWindow({"source": "Source", **titles})
    controller = SessionController(window, catalogue)
    controller.session = controller.session.with_device(session.device)
    autosave = connect(controller, theme)
    if restore:
        autosave.restore_geometry()
    controller.relay.catch_uncaught()
    window.show()
    _wait_until_exposed(window)
    if with_scene:
        QTimer.singleShot(0, controller.views.scene.open)
    path = session.recording
    if path is not None:
        if is_rollout_folder(path) or is_track_folder(path) or list_recordings(path):
            controller.open_path(path)
        else:
            controller.saved_session = session  # what the command line asks for is no change
            controller.show_session(session)
            controller.recording_opened.emit(path)
    if restore:
        autosave.offer_recovery()
    logging.getLogger("tactoscope").info("Tactoscope is ready")
    return controller


def _wait_until_exposed(window: MainWindow) -> None:
    """Paint the window before recording, kernels and OpenGL load, which hold the interpreter
    lock.
    """
    from PyQt6.QtWidgets import QApplication

    end_s = time.monotonic() + _SHOW_TIMEOUT_S
    handle = window.windowHandle()
    while handle is not None and not handle.isExposed() and time.monotonic() < end_s:
        QApplication.processEvents()
        time.sleep(0.002)
    window.repaint()
    QApplication.processEvents()
