"""Under the 3D views: what is seen, and in whose frame, stretched how far."""

from __future__ import annotations

from PyQt6.QtGui import QGuiApplication

from app.window.main_window import MainWindow
from pipeline.previews.display_params import DisplayParams
from pipeline.translation.translate import Translation
from widgets.theme import get_theme_colours, to_hex
from widgets.view_3d_panel import View3DPanel

_TIMES = "\N{MULTIPLICATION SIGN}"
_SOURCE_LEGEND = "reading on its surface"


def show_captions(window: MainWindow, opened: Translation, display: DisplayParams) -> None:
    """Say so under every view, the axes in the colours that are on."""
    window.truth_view_panel.caption.set_texts(*_tellings(opened.target.name, 1.0))
    _show(window.view_panels["source"], _SOURCE_LEGEND, opened.source.name, 1.0)
    for slot in opened.catalogue.stages:
        place = opened.source if slot.sensor_role == "source" else opened.target
        _show(
            window.view_panels[slot.name],
            slot.legend,
            place.name,
            display.get_depth_stretch(place) if slot.exaggerates_indentation else 1.0,
        )


def _show(cell: View3DPanel, legend: str, frame: str, times: float) -> None:
    cell.legend.setText(legend)
    cell.legend.setToolTip(legend)
    cell.caption.set_texts(*_tellings(frame, times))


def _tellings(frame: str, times: float) -> tuple[str, str, str]:
    """Whose frame, its axes, how far stretched: in full, in short, and where there is hardly any room."""
    stretched = "" if times == 1.0 else f"{_TIMES}{times:g}"
    end = f", depth {stretched}" if stretched else ""
    return f"{frame} frame {_axes()}{end}", f"{frame} {_axes()} {stretched}".rstrip(), f"{_axes()} {stretched}".rstrip()


def _axes() -> str:
    colours = zip("xyz", get_theme_colours(QGuiApplication.palette()).axes, strict=True)
    return " ".join(f"<b style='color:{to_hex(colour)}'>{name}</b>" for name, colour in colours)
