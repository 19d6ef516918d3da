"""Make the pictures of README.md and docs/tour.md: the window itself, as it is now, on the sample recordings.

    xvfb-run -a -s "-screen 0 1600x950x24" python docs/make_tour.py [FOLDER [NAME ...]]

`make tour` does so. Nothing is retouched: each picture is what the window shows after the steps that the text tells.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from app.main import let_go, make_application, prepare_environment, show_window
from app.session.sample import SAMPLE

prepare_environment()

from PyQt6.QtCore import QCoreApplication, QSettings

from app.frame.basins import BasinsTab
from app.frame.comparing import Comparing
from app.frame.instrument import Instrument
from app.frame.living import Living
from app.frame.tour import follow_a_pixel, save_window_picture, wait_until_shown
from app.session.state import Session
from pipeline.live.simulated import Simulated
from pipeline.sensors.offsets import Offsets

SIZE_PX = (1600, 950)
LIMIT_S, QUIET_S = 300.0, 3.0
PAIRED = SAMPLE.with_name("digit_gelslim.h5")


def until(met: Callable[[], bool]) -> None:
    """Let the window work until `met`; ends the program if that takes too long."""
    end_s = time.monotonic() + LIMIT_S
    while not met():
        if time.monotonic() > end_s:
            raise SystemExit("the window did not come to where the tour wants it")
        QCoreApplication.processEvents()
        time.sleep(0.005)


def shown(instrument: Instrument) -> None:
    """Wait for everything that was asked for."""
    if not wait_until_shown(instrument, LIMIT_S):
        raise SystemExit(instrument.window.banner.text or "not shown in time")


def at_rest(instrument: Instrument) -> None:
    """Wait until nothing has been worked out for a while, beside the stages too."""
    since_s = time.monotonic()
    while time.monotonic() - since_s < QUIET_S:
        until(lambda: instrument.idle)
        if instrument.job.busy:
            since_s = time.monotonic()
        QCoreApplication.processEvents()
        time.sleep(0.005)


def open_sample(instrument: Instrument, *, frame: int) -> None:
    """Open the sample on a touched frame."""
    instrument.show_session(Session(recording=SAMPLE, source="gelslim", target="soft_bubble", frame=frame))
    shown(instrument)


def command(instrument: Instrument, name: str) -> None:
    """Trigger a command by its name."""
    instrument.window.actions_by_name[name].trigger()


def welcome(instrument: Instrument, path: Path) -> None:
    """An empty window."""
    save_window_picture(instrument, path)


def inspect(instrument: Instrument, path: Path) -> None:
    """The worst frame, with the truth beside it and its error taken apart."""
    open_sample(instrument, frame=5)
    window = instrument.window
    window.drawers.frames.show()
    opened = instrument.screen.opened
    assert opened is not None
    n = opened.n_frames
    until(lambda: all(window.frames.known.known(i) is not None for i in range(n)) and instrument.idle)
    command(instrument, "worse")
    shown(instrument)
    for _ in range(n):
        command(instrument, "worse")
    shown(instrument)
    command(instrument, "show_wipe")
    shown(instrument)
    window.drawers.reading.show()
    window.tabs.setCurrentWidget(window.blame)
    at_rest(instrument)
    save_window_picture(instrument, path)


def stages(instrument: Instrument, path: Path) -> None:
    """Every slot side by side, a pixel followed through all of them."""
    open_sample(instrument, frame=5)
    at_rest(instrument)
    follow_a_pixel(instrument)
    at_rest(instrument)
    save_window_picture(instrument, path)


def filmstrip(instrument: Instrument, path: Path) -> None:
    """Two slots large under a strip of all."""
    open_sample(instrument, frame=5)
    command(instrument, "layout_inspect")
    shown(instrument)
    at_rest(instrument)
    save_window_picture(instrument, path)


def compare(instrument: Instrument, path: Path) -> None:
    """The same frame by every method that has weights."""
    comparing = _compared(instrument)
    until(lambda: not comparing.busy and len(instrument.window.compare.tab.grid.tiles) > 2)
    at_rest(instrument)
    save_window_picture(instrument, path)


def two(instrument: Instrument, path: Path) -> None:
    """Two ways to the target's view on one frame and view."""
    comparing = _compared(instrument)
    command(instrument, "hold_settings")
    instrument.choose_method("view", "paper")
    shown(instrument)
    box = instrument.window.compare.slot
    box.setCurrentIndex(box.findData("view"))
    box.activated.emit(box.currentIndex())
    until(lambda: not comparing.busy and len(instrument.window.compare.tab.grid.tiles) == 3)
    at_rest(instrument)
    save_window_picture(instrument, path)


def seeds(instrument: Instrument, path: Path) -> None:
    """Eight samples of one touch."""
    comparing = _compared(instrument)
    instrument.window.compare.show_tab("seeds")
    method = instrument.catalogue.method("touch", "t2d2")
    instrument.choose_method("touch", "t2d2")
    instrument.choose_params(method.key, replace(method.params(), steps=4))
    shown(instrument)
    instrument.window.compare.draw.click()
    until(lambda: not comparing.busy and len(instrument.window.compare.tab.grid.tiles) == 5)
    at_rest(instrument)
    save_window_picture(instrument, path)


def basins(instrument: Instrument, path: Path) -> None:
    """Where the registration of one touch ends, from all around."""
    open_sample(instrument, frame=8)
    at_rest(instrument)
    command(instrument, "map_basins")
    tab = next(child for child in instrument.children() if isinstance(child, BasinsTab))
    until(lambda: tab.found is not None)
    at_rest(instrument)
    save_window_picture(instrument, path)


def _compared(instrument: Instrument) -> Comparing:
    """*Compare* on a touched frame."""
    open_sample(instrument, frame=5)
    command(instrument, "layout_compare")
    shown(instrument)
    return next(child for child in instrument.children() if isinstance(child, Comparing))


def demo(instrument: Instrument, path: Path) -> None:
    """Source, generated and truth, large."""
    instrument.show_session(Session(recording=PAIRED, source="digit", target="gelslim", frame=3))
    shown(instrument)
    command(instrument, "layout_demo")
    shown(instrument)
    save_window_picture(instrument, path)


def align(instrument: Instrument, path: Path) -> None:
    """A handle two millimetres off."""
    instrument.show_session(Session(recording=PAIRED, source="digit", target="gelslim", frame=3))
    shown(instrument)
    command(instrument, "layout_align")
    shown(instrument)
    instrument.change("move the alignment", offsets=Offsets(shift_mm=(2.0, 0.0, 0.0), pivot_mm=(0.0, 0.0, 22.0)))
    shown(instrument)
    at_rest(instrument)
    save_window_picture(instrument, path)


def live(instrument: Instrument, path: Path) -> None:
    """A simulated sensor, watched."""
    living = next(child for child in instrument.children() if isinstance(child, Living))
    instrument.show_session(Session(target="gelslim"))
    living.watch(Simulated(sensor="digit", tool="sphere", rate_hz=15.0))
    until(lambda: living.reader is not None and living.reader.n_frames > 24 and living.on_screen)
    living.follow(on=False)
    instrument.choose_frame(20)
    shown(instrument)
    save_window_picture(instrument, path)
    living.stop()


PICTURES = {
    "welcome": welcome, "stages": stages, "filmstrip": filmstrip, "inspect": inspect, "compare": compare, "two": two,
    "seeds": seeds, "basins": basins, "demo": demo, "align": align, "live": live,
}  # fmt: skip


def main() -> None:
    """Make them all, or those that are named."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "tour"
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as forgotten:  # what people had open is nobody's business
        QSettings.setPath(QSettings.Format.IniFormat, QSettings.Scope.UserScope, forgotten)
        for name, make in PICTURES.items():
            if len(sys.argv) > 2 and name not in sys.argv[2:]:
                continue
            instrument = show_window(Session())
            instrument.window.resize(*SIZE_PX)
            QCoreApplication.processEvents()
            make(instrument, out / f"{name}.png")
            let_go(instrument)
            print(out / f"{name}.png", flush=True)


if __name__ == "__main__":
    application = make_application()
    main()
