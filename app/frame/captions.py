"""Under the 3D views: what is seen, and in whose frame, stretched how far."""

from __future__ import annotations

from PyQt6.QtGui import QGuiApplication

from app.frame.window import Window
from pipeline.pictures.display import DisplayParams
from pipeline.translation.translate import Translation
from widgets.colours import hexed, inks
from widgets.solid_cell import SolidCell

_TIMES = "\N{MULTIPLICATION SIGN}"
_SOURCE_LEGEND = "reading on its surface"


def show_captions(window: Window, opened: Translation, display: DisplayParams) -> None:
    """Say so under every view, the axes in the colours that are on."""
    window.truth_cell.caption.say(*_tellings(opened.target.name, 1.0))
    _show(window.cells["source"], _SOURCE_LEGEND, opened.source.name, 1.0)
    for slot in opened.catalogue.slots:
        place = opened.source if slot.place == "source" else opened.target
        _show(window.cells[slot.name], slot.legend, place.name, display.stretch(place) if slot.stretches else 1.0)


def _show(cell: SolidCell, legend: str, frame: str, times: float) -> None:
    cell.legend.setText(legend)
    cell.legend.setToolTip(legend)
    cell.caption.say(*_tellings(frame, times))


def _tellings(frame: str, times: float) -> tuple[str, str, str]:
    """Whose frame, its axes, how far stretched: in full, in short, and where there is hardly any room."""
    stretched = "" if times == 1.0 else f"{_TIMES}{times:g}"
    end = f", depth {stretched}" if stretched else ""
    return f"{frame} frame {_axes()}{end}", f"{frame} {_axes()} {stretched}".rstrip(), f"{_axes()} {stretched}".rstrip()


def _axes() -> str:
    colours = zip("xyz", inks(QGuiApplication.palette()).axes, strict=True)
    return " ".join(f"<b style='color:{hexed(colour)}'>{name}</b>" for name, colour in colours)
