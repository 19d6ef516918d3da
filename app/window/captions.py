"""Captions of the 3D views: legend, coordinate frame, axes and depth stretch."""

from __future__ import annotations

from html import escape

from PyQt6.QtGui import QGuiApplication

from app.window.main_window import MainWindow
from app.window.scene_geometry import get_depth_stretch
from pipeline.previews.display_params import DisplayParams
from pipeline.translation.translate import Translation
from widgets.theme import get_theme_colours, to_hex
from widgets.view_3d_panel import View3DPanel

_TIMES = "\N{MULTIPLICATION SIGN}"
_SOURCE_LEGEND = "image on the sensor surface"


def show_captions(window: MainWindow, opened: Translation, display: DisplayParams) -> None:
    """Update the captions, with the axes in the colours of the theme."""
    window.truth_view_panel.caption.set_texts(*_format_captions(opened.target.name, 1.0))
    _show_caption(window.view_panels["source"], _SOURCE_LEGEND, opened.source.name, 1.0)
    for stage in opened.catalogue.stages:
        stretch = get_depth_stretch(stage.name, opened, display)
        _show_caption(window.view_panels[stage.name], stage.legend, opened.get_sensor(stage.name).name, stretch)


def _show_caption(panel: View3DPanel, legend: str, frame: str, stretch: float) -> None:
    panel.legend.setText(legend)
    panel.legend.setToolTip(legend)
    panel.caption.set_texts(*_format_captions(frame, stretch))


def _format_captions(frame: str, stretch: float) -> tuple[str, str, str]:
    """Return frame, axes and depth stretch at three lengths, from full to shortest."""
    stretched = "" if stretch == 1.0 else f"{_TIMES}{stretch:g}"
    end, frame = f", depth {stretched}" if stretched else "", escape(frame)
    return (
        f"{frame} frame {_format_axes()}{end}",
        f"{frame} {_format_axes()} {stretched}".rstrip(),
        f"{_format_axes()} {stretched}".rstrip(),
    )


def _format_axes() -> str:
    colours = zip("xyz", get_theme_colours(QGuiApplication.palette()).axes, strict=True)
    return " ".join(f"<b style='color:{to_hex(colour)}'>{name}</b>" for name, colour in colours)
