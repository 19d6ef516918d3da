"""Make a picture of every screen of the window in both themes, at one size, to be looked at.

    xvfb-run -a -s "-screen 0 1366x768x24" python docs/make_screens.py FOLDER 1366x768 [NAME ...]
    QT_SCALE_FACTOR=2 xvfb-run -a -s "-screen 0 3200x1900x24" python docs/make_screens.py FOLDER
      1600x950 [NAME ...]

The size is the window's as Qt counts, so that twice the scale needs a screen of twice as many
pixels either way.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import make_tour as tour
from PyQt6.QtCore import QCoreApplication, QSettings

from app.compare.comparison import ComparisonController
from app.document.session_controller import SessionController
from app.live.live import LiveController
from app.main import close_window, make_application, show_window
from app.session.state import Session
from app.shell.tour import pin_deepest_pixel, save_window_screenshot
from pipeline.io.live.source_parsing import SimulatedSource
from pipeline.sensors.alignment import Offsets


def welcome(_: SessionController) -> None:
    """An empty window."""


def look(instrument: SessionController) -> None:
    """Every stage of a frame with contact, and the trace of a pixel."""
    tour.open_sample(instrument, frame=5)
    tour.wait_for_idle(instrument)
    pin_deepest_pixel(instrument)


def drawers(instrument: SessionController) -> None:
    """All drawers open."""
    for drawer in instrument.window.drawers:
        drawer.show()
    tour.wait_for_idle(instrument)


def steps(instrument: SessionController) -> None:
    """A step of the registration."""
    tour.command(instrument, "step_through")
    tour.wait_for_views(instrument)
    tour.wait_for_idle(instrument)
    instrument.window.steps["pose"].slider.setValue(1)


def section(instrument: SessionController) -> None:
    """A line through all panes, and its curves."""
    for drawer in instrument.window.drawers:
        drawer.hide()
    tour.command(instrument, "section_line")
    tour.wait_for_idle(instrument)


def align(instrument: SessionController) -> None:
    """A handle two millimetres off, measured and transferred contact."""
    instrument.set_section(None)
    instrument.window.drawers.diagnostics.hide()
    instrument.show_session(
        Session(recording=tour.PAIRED, source="digit", target="gelslim", frame=3)
    )
    tour.wait_for_views(instrument)
    _layout(instrument, "align")
    instrument.change(
        "move the alignment",
        offsets=Offsets(translation_mm=(2.0, 0.0, 0.0), pivot_mm=(0.0, 0.0, 22.0)),
    )
    tour.wait_for_views(instrument)
    tour.wait_for_idle(instrument)


def grid(instrument: SessionController) -> None:
    """The two parameters that it opens on, all cells filled."""
    tour.open_sample(instrument, frame=5)
    _layout(instrument, "compare")
    instrument.window.comparison.show_tab("grid")
    tour.wait_for_views(instrument)
    tab = instrument.window.comparison.grid
    tour.until(lambda: tab.axes[0].count() > 0)
    tab.start_button.click()
    tour.until(lambda: "click" not in tab.message.text() and tab.run_bar.bar.isHidden())
    tour.wait_for_idle(instrument)


def compare(instrument: SessionController) -> None:
    """Every method on one frame."""
    _layout(instrument, "compare")
    comparing = next(
        child for child in instrument.children() if isinstance(child, ComparisonController)
    )
    tour.until(
        lambda: (
            not comparing.is_busy and len(instrument.window.comparison.current_tab.grid.tiles) > 2
        )
    )


def two(instrument: SessionController) -> None:
    """Two settings on one frame."""
    comparing = next(
        child for child in instrument.children() if isinstance(child, ComparisonController)
    )
    tour.command(instrument, "set_variant_settings")
    instrument.choose_method("target_depth", "paper")
    tour.wait_for_views(instrument)
    box = instrument.window.comparison.stage_box
    box.setCurrentIndex(box.findData("target_depth"))
    box.activated.emit(box.currentIndex())
    tour.until(
        lambda: (
            not comparing.is_busy and len(instrument.window.comparison.current_tab.grid.tiles) == 3
        )
    )
    tour.wait_for_idle(instrument)


def live(instrument: SessionController) -> None:
    """A simulated sensor, watched."""
    _layout(instrument, "look")
    living = next(child for child in instrument.children() if isinstance(child, LiveController))
    instrument.show_session(Session(target="gelslim"))
    living.watch_source(SimulatedSource(sensor="digit", tool="sphere", rate_hz=5.0))
    tour.until(
        lambda: living.reader is not None and living.reader.n_frames > 12 and living.is_on_screen
    )
    living.set_following(on=False)
    instrument.choose_frame(10)
    tour.wait_for_views(instrument)


SCREENS: dict[str, Callable[[SessionController], None]] = {
    "welcome": welcome,
    "look": look,
    "drawers": drawers,
    "steps": steps,
    "section": section,
    "align": align,
    "grid": grid,
    "compare": compare,
    "two": two,
    "live": live,
}


def _layout(instrument: SessionController, name: str) -> None:
    tour.command(instrument, f"layout_{name}")
    tour.wait_for_views(instrument)
    tour.wait_for_idle(instrument)


def main() -> None:
    """Go through all screens, or the first ones up to the last that is named, and write those
    that are named.
    """
    out, (wide, high), names = (
        Path(sys.argv[1]),
        map(int, sys.argv[2].split("x")),
        sys.argv[3:] or list(SCREENS),
    )
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as forgotten:
        QSettings.setPath(QSettings.Format.IniFormat, QSettings.Scope.UserScope, forgotten)
        instrument = show_window(Session())
        instrument.window.resize(wide, high)
        QCoreApplication.processEvents()
        for name, make in SCREENS.items():
            make(instrument)
            if name in names:
                for theme in ("dark", "light"):
                    tour.command(instrument, f"theme_{theme}")
                    QCoreApplication.processEvents()  # the 3D views ask for their pictures anew
                    save_window_screenshot(instrument, out / f"{name}_{theme}.png")
                print(out / name, flush=True)
            names = [other for other in names if other != name]
            if not names:
                break
        close_window(instrument)


if __name__ == "__main__":
    application = make_application()
    main()
