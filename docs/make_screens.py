"""Make a picture of every screen of the window in both themes, at one size, to be looked at.

    xvfb-run -a -s "-screen 0 1366x768x24" python docs/make_screens.py FOLDER 1366x768 [NAME ...]
    QT_SCALE_FACTOR=2 xvfb-run -a -s "-screen 0 3200x1900x24" python docs/make_screens.py FOLDER 1600x950 [NAME ...]

The size is the window's as Qt counts, so that twice the scale needs a screen of twice as many pixels either way.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import make_tour as tour
from PyQt6.QtCore import QCoreApplication, QSettings

from app.frame.basins import BasinsTab
from app.frame.comparing import Comparing
from app.frame.instrument import Instrument
from app.frame.living import Living
from app.frame.sweeping import Sweeping
from app.frame.tour import follow_a_pixel, save_window_picture
from app.main import let_go, make_application, show_window
from app.session.state import Session
from pipeline.live.simulated import Simulated
from pipeline.sensors.offsets import Offsets


def welcome(_: Instrument) -> None:
    """An empty window."""


def stages(instrument: Instrument) -> None:
    """Every slot of a touched frame, a pixel followed."""
    tour.open_sample(instrument, frame=5)
    tour.at_rest(instrument)
    follow_a_pixel(instrument)


def drawers(instrument: Instrument) -> None:
    """All drawers open."""
    for drawer in instrument.window.drawers.all:
        drawer.show()
    tour.at_rest(instrument)


def basins(instrument: Instrument) -> None:
    """The basin map, with the drawers that it opens."""
    tour.command(instrument, "map_basins")
    tab = next(child for child in instrument.children() if isinstance(child, BasinsTab))
    tour.until(lambda: tab.found is not None)
    tour.at_rest(instrument)


def steps(instrument: Instrument) -> None:
    """A step of the registration."""
    tour.command(instrument, "step_through")
    tour.shown(instrument)
    tour.at_rest(instrument)
    instrument.window.steps["pose"].slider.setValue(1)


def inspect(instrument: Instrument) -> None:
    """Two panes under a filmstrip."""
    for drawer in instrument.window.drawers.all:
        drawer.hide()
    _layout(instrument, "inspect")


def section(instrument: Instrument) -> None:
    """A line through both panes, and its curves."""
    tour.command(instrument, "section_line")
    tour.at_rest(instrument)


def align(instrument: Instrument) -> None:
    """A handle two millimetres off, felt beside carried over."""
    instrument.move_section(None)
    instrument.window.drawers.reading.hide()
    instrument.show_session(Session(recording=tour.PAIRED, source="digit", target="gelslim", frame=3))
    tour.shown(instrument)
    _layout(instrument, "align")
    instrument.change("move the alignment", offsets=Offsets(shift_mm=(2.0, 0.0, 0.0), pivot_mm=(0.0, 0.0, 22.0)))
    tour.shown(instrument)
    tour.at_rest(instrument)


def demo(instrument: Instrument) -> None:
    """Source, generated and truth."""
    instrument.change("put it back", offsets=Offsets())
    _layout(instrument, "demo")


def sweep(instrument: Instrument) -> None:
    """The two parameters that it opens on, all cells filled."""
    tour.open_sample(instrument, frame=5)
    _layout(instrument, "sweep")
    sweeping = next(child for child in instrument.children() if isinstance(child, Sweeping))
    instrument.window.sweep.sweep_wanted.emit()
    tour.until(lambda: not sweeping.busy)
    tour.at_rest(instrument)


def compare(instrument: Instrument) -> None:
    """Every method on one frame."""
    _layout(instrument, "compare")
    comparing = next(child for child in instrument.children() if isinstance(child, Comparing))
    tour.until(lambda: not comparing.busy and len(instrument.window.compare.tab.grid.tiles) > 2)


def two(instrument: Instrument) -> None:
    """Two settings on one frame."""
    comparing = next(child for child in instrument.children() if isinstance(child, Comparing))
    tour.command(instrument, "hold_settings")
    instrument.choose_method("view", "paper")
    tour.shown(instrument)
    box = instrument.window.compare.slot
    box.setCurrentIndex(box.findData("view"))
    box.activated.emit(box.currentIndex())
    tour.until(lambda: not comparing.busy and len(instrument.window.compare.tab.grid.tiles) == 3)
    tour.at_rest(instrument)


def live(instrument: Instrument) -> None:
    """A simulated sensor, watched."""
    _layout(instrument, "stages")
    living = next(child for child in instrument.children() if isinstance(child, Living))
    instrument.show_session(Session(target="gelslim"))
    living.watch(Simulated(sensor="digit", tool="sphere", rate_hz=5.0))
    tour.until(lambda: living.reader is not None and living.reader.n_frames > 12 and living.on_screen)
    living.follow(on=False)
    instrument.choose_frame(10)
    tour.shown(instrument)


SCREENS: dict[str, Callable[[Instrument], None]] = {
    "welcome": welcome, "stages": stages, "drawers": drawers, "basins": basins, "steps": steps, "inspect": inspect,
    "section": section, "align": align,
    "demo": demo, "sweep": sweep, "compare": compare, "two": two, "live": live,
}  # fmt: skip


def _layout(instrument: Instrument, name: str) -> None:
    tour.command(instrument, f"layout_{name}")
    tour.shown(instrument)
    tour.at_rest(instrument)


def main() -> None:
    """Go through all screens, or the first ones up to the last that is named, and write those that are named."""
    out, (wide, high), names = Path(sys.argv[1]), map(int, sys.argv[2].split("x")), sys.argv[3:] or list(SCREENS)
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
                    save_window_picture(instrument, out / f"{name}_{theme}.png")
                print(out / name, flush=True)
            names = [other for other in names if other != name]
            if not names:
                break
        let_go(instrument)


if __name__ == "__main__":
    application = make_application()
    main()
