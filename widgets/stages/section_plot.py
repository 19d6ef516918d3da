"""Plot of the heights of all stages along one line, over the same millimetres."""

from typing import Any, Literal

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QBrush

from pipeline.translation.cross_section import CrossSection, HeightProfile
from pipeline.views.colours import Rgb
from widgets.style.plots import Plot
from widgets.style.theme import CATEGORY_COLOURS, ThemeColours, to_qcolor

_Style = Qt.PenStyle
# colour, dashes, width in px
_Stroke = tuple[Rgb | Literal["neutral", "accent", "text"], Qt.PenStyle, float]
# Colours alone do not separate overlapping curves.
_STROKES: dict[str, _Stroke] = {
    "source": ("neutral", _Style.SolidLine, 1.8),
    "depth": ("accent", _Style.SolidLine, 1.8),
    "cloud": (CATEGORY_COLOURS[1], _Style.DotLine, 2.6),
    "target_depth": (CATEGORY_COLOURS[2], _Style.DashLine, 1.8),
    "touch": (CATEGORY_COLOURS[3], _Style.SolidLine, 3.0),
    "touch_depth": (CATEGORY_COLOURS[5], _Style.DashDotLine, 1.8),
    "true_source": ("accent", _Style.DotLine, 1.8),
    "true_target": ("text", _Style.SolidLine, 1.3),
}
_OTHER: _Stroke = "neutral", _Style.DashLine, 1.8


class SectionPlot(Plot):
    """Plots a `CrossSection`: mm along the line against mm of indentation, with gaps where
    nothing is known.
    """

    preferred_px = 640, 180

    def __init__(self) -> None:
        super().__init__("section_plot", "indentation along the section line")
        self.section: CrossSection | None = None
        self.sensor_role = ""  # sensor whose curves are drawn, "" = both
        self._legend: Any = None
        self._curves: dict[str, Any] = {}  # by the names of their profiles
        self._edges: Any = None  # of contact
        self.setMinimumSize(280, 110)
        self.setToolTip(
            "Indentation of every stage along the line, + toward the camera; marks at the bottom: "
            "start and "
            "end of its contact. Cloud points: perpendicular to the target's rest surface"
        )

    def show_section(self, section: CrossSection | None) -> None:
        """Draw this section."""
        if section is self.section:
            return
        self.section = section
        if self._curves.keys() == {profile.name for profile in self.visible_profiles}:
            self._show_profiles()  # a drag of the line: new items would cost as much as ten updates
        else:
            self.redraw()

    def show_sensor_role(self, place: str) -> None:
        """Draw the curves of the source or of the target alone; "" draws both."""
        self.sensor_role = place
        self.redraw()

    @property
    def visible_profiles(self) -> tuple[HeightProfile, ...]:
        """The curves that have a value anywhere."""
        profiles = () if self.section is None else self.section.profiles
        return tuple(
            p
            for p in profiles
            if self.sensor_role in ("", p.place) and np.isfinite(p.heights_mm).any()
        )

    def draw(self, pyqtgraph: Any, ink: ThemeColours) -> None:
        """Draw curves, contact edges and legend."""
        axes = self.prepare_axes(pyqtgraph, 0, "along the line A to B, mm", "indentation, mm")
        text = self.palette().windowText().color()
        if self._legend is None:
            self._legend = pyqtgraph.LegendItem(verSpacing=-8)
            self._view.addItem(self._legend, row=0, col=2)
        self._legend.clear()
        self._legend.setLabelTextColor(text)
        own = {"neutral": to_qcolor(ink.neutral), "accent": to_qcolor(ink.accent), "text": text}
        self._curves = {}
        for profile in self.visible_profiles:
            colour, style, width = _STROKES.get(profile.name, _OTHER)
            shade = own[colour] if isinstance(colour, str) else to_qcolor(colour)
            curve = self._curves[profile.name] = axes.plot(
                pen=pyqtgraph.mkPen(shade, width=width, style=style), connect="finite"
            )
            curve.setZValue(-width)  # wide ones below, so that none is hidden
            self._legend.addItem(curve, profile.title)
        self._edges = axes.plot(pen=None, symbol="t1", symbolSize=7, symbolPen=None)
        self._show_profiles()

    def _show_profiles(self) -> None:
        profiles = self.visible_profiles
        section = self.section
        if section is None or not profiles or not self.isVisible():
            return
        low = min(0.0, *(float(np.nanmin(profile.heights_mm)) for profile in profiles))
        places: list[float] = []
        brushes: list[QBrush] = []
        for profile in profiles:
            curve = self._curves[profile.name]
            curve.setData(section.along_mm, profile.heights_mm)
            places += profile.contact_edges_mm
            brushes += [QBrush(curve.opts["pen"].color())] * len(profile.contact_edges_mm)
        self._edges.setData(places, [low] * len(places), symbolBrush=brushes)
