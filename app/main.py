"""Starting the window: what must be set before Qt is loaded, and what may come after it is on screen."""

from __future__ import annotations

import gc
import logging
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from app.session.sample import SAMPLE_RECORDING
from pipeline.base.allocator import limit_arenas

if TYPE_CHECKING:
    from PyQt6.QtWidgets import QApplication

    from app.session.state import Session
    from app.window.main_window import MainWindow
    from app.window.session_controller import SessionController
    from pipeline.translation.catalogue import Catalogue
    from pipeline.translation.translate import Request

_PATIENCE_S = 1.0  # for the window to be on screen; one that is opened minimised never is
# Objects made until the youngest, and rounds until the older ones are looked through. Loading Qt, VTK and numba makes
# millions that stay: as Python has it, looking through them takes a tenth of the time to the first touch.
_GARBAGE_AFTER = 50_000, 20, 50
_THREADS_LEFT_ALONE = "PASSIVE"  # waiting OpenMP threads that spin would take the processor from the window


def open_window(request: Request | None, *, frame: int | None = None, tour: Path | None = None) -> int:
    """Show the window until it is closed, or give the `tour` and close; returns the exit code of the process.

    `request` None shows the welcome page, or opens the sample where a frame or a tour is asked for. See
    `app.window.tour` for what a tour leaves behind.
    """
    prepare_environment()
    from app.session.state import AUTO_FRAME, REQUEST_FIELDS, Session
    from app.shutdown import ShutdownHandler
    from app.window.preload import PreloadController

    application = make_application()
    first = AUTO_FRAME if frame is None else frame
    if request is None:
        asked_for = SAMPLE_RECORDING.exists() and (frame is not None or tour is not None)
        session = Session(recording=SAMPLE_RECORDING if asked_for else None, frame=first)
    else:
        asked = {name: getattr(request, name) for name in REQUEST_FIELDS}
        methods, weights = dict(request.methods), dict(request.weights)
        session = Session(**asked, offsets=request.offsets, methods=methods, weights=weights, frame=first)
    controller = show_window(session, remembers=tour is None)
    ending = ShutdownHandler(controller)
    if tour is None:
        PreloadController(controller)
    try:
        if tour is None:
            code = application.exec()
        else:
            from app.window.tour import run_tour

            code = run_tour(controller, tour, show_frame=frame)
        return ending.code or code
    finally:
        ending.restore_signal_handlers()
        close_window(controller)


def close_window(controller: SessionController) -> None:
    """Close the window and destroy it: one that outlives its application ends the process with a crash."""
    from PyQt6 import sip

    controller.close()
    if not sip.isdeleted(controller.window):
        sip.delete(controller.window)


def prepare_environment() -> None:
    """Before anything loads: idle threads do not spin, garbage is not looked for all along, threads share heaps."""
    limit_arenas()
    os.environ.setdefault("OMP_WAIT_POLICY", _THREADS_LEFT_ALONE)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads spin, and no product here is large enough for two
    gc.set_threshold(*_GARBAGE_AFTER)


def make_application() -> QApplication:
    """The one application, in our style."""
    from PyQt6.QtWidgets import QApplication

    from app.shutdown import destroy_windows_at_exit

    destroy_windows_at_exit()
    running = QApplication.instance()
    if isinstance(running, QApplication):
        return running
    application = QApplication([sys.argv[0]])
    application.setApplicationName("Tactoscope")
    return application


def show_window(
    session: Session, *, with_scene: bool = True, catalogue: Catalogue | None = None, remembers: bool = False
) -> SessionController:
    """A window on `session`, on screen before the recording is read and before OpenGL is loaded.

    `catalogue` None is what this program knows of slots, methods and routes. One that `remembers` stands where the
    last one stood, and offers the session of one that was ended from outside.
    """
    from PyQt6.QtCore import QTimer
    from PyQt6.QtWidgets import QApplication

    from app.session.preferences import Preferences
    from app.window.connections import connect
    from app.window.main_window import MainWindow
    from app.window.session_controller import SessionController
    from app.window.themes import apply_theme
    from pipeline.translation.catalogue import BUILT_IN

    QApplication.setStyle("Fusion")
    theme = Preferences().theme if remembers else "light"
    apply_theme(theme)
    catalogue = catalogue or BUILT_IN
    scrubbed = frozenset(slot.name for slot in catalogue.stages if slot.has_steps)
    window = MainWindow([("source", "Source"), *((slot.name, slot.title) for slot in catalogue.stages)], scrubbed)
    controller = SessionController(window, catalogue)
    keeping = connect(controller, theme)
    if remembers:
        keeping.restore_geometry()
    controller.relay.catch_uncaught()
    window.show()
    _wait_until_seen(window)
    if with_scene:
        QTimer.singleShot(0, lambda: _add_scene(controller))
    if session.recording is not None:
        controller.show_session(session)
        controller.saved_session = session
    if remembers:
        keeping.offer_recovery()
    logging.getLogger("tactoscope").info("Tactoscope is ready")
    return controller


def _wait_until_seen(window: MainWindow) -> None:
    """Paint the window before recording, kernels and OpenGL are loaded, which share one interpreter's lock with it."""
    from PyQt6.QtWidgets import QApplication

    end_s, handle = time.monotonic() + _PATIENCE_S, window.windowHandle()
    while handle is not None and not handle.isExposed() and time.monotonic() < end_s:
        QApplication.processEvents()
        time.sleep(0.002)
    window.repaint()
    QApplication.processEvents()


def _add_scene(controller: SessionController) -> None:
    from widgets.vtk_scene_renderer import create_scene_renderer

    controller.views.set_scene(create_scene_renderer(controller.window.views_3d), controller.session)
