"""The section line through all images, in millimetres, and the height curves along it in a tab."""

from functools import partial

import numpy as np
from PyQt6.QtCore import QEvent, QPointF

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.stage_previews import SourcePreview, StagePreview
from pipeline.core.values.results import DepthMap
from pipeline.translation import cross_section
from pipeline.translation.cross_section import HeightMap, SectionLine
from pipeline.translation.pixel_trace import SOURCE
from widgets.stages.section_panel import SectionLineTool
from widgets.style.base import EventListener
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 15  # updates within it are drawn together
_DEFAULT_ENDS = -0.9, 0.9  # of the default line, in halves of the source's width
_DIGITS = 2  # decimals of a coordinate in mm
_OUTDATED = ("failed", "waiting")  # column states of another frame


class SectionLineController(Feature):
    """Connects the images, the tab, the command and the session's section line."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.section_panel
        self._action = self._actions["section_line"]
        self._last_line: SectionLine | None = None  # before it was removed
        self._tools = {
            name: SectionLineTool(column.view.canvas) for name, column in self._columns.items()
        }
        for name, tool in self._tools.items():
            tool.line_moved.connect(partial(self._move_end, name))
        # Two timers, so that neither blocks the window for long: lines first, then curves.
        self._line_timer = make_single_shot_timer(self, _DELAY_MS, self._show_line)
        self._curve_timer = make_single_shot_timer(self, _DELAY_MS, self._show_curves)
        self._panel.line_typed.connect(controller.set_section)
        self._panel.add_command(self._action)
        EventListener(self._panel, self._update_soon, QEvent.Type.Show)
        self._window.connect_command("section_line", self._toggle)
        controller.section_changed.connect(self._show_change)
        controller.job.delivered.connect(self._update_soon)

    def _toggle(self) -> None:
        line = None
        if self._controller.section is None:
            line = self._last_line or self._make_default_line()
        self._action.setChecked(line is not None)  # None where nothing is open
        self._controller.set_section(line)
        if line is not None:
            self._window.show_diagnostics(self._panel)

    def _make_default_line(self) -> SectionLine | None:
        """Return a horizontal line on the source through the deepest indentation.

        None if nothing is open.
        """
        opened = self._translation
        if opened is None:
            return None
        camera = opened.source.camera
        y_px = 0.5 * (camera.rows - 1)
        part = self._views.get_shown_stage("depth")
        depth = part.result.output if isinstance(part, StagePreview) else None
        if isinstance(depth, DepthMap) and depth.contact.any():
            camera = depth.camera
            inside = np.where(depth.contact, depth.indentation_mm, -np.inf)
            y_px = float(np.nanargmax(inside) // camera.cols)
        plane = cross_section.build_plane(opened, "source", camera)
        ends_px = 0.5 * (camera.cols - 1) + 0.5 * camera.cols * np.array(_DEFAULT_ENDS)
        return _make_line(*(plane.backproject_to_mm(float(x_px), y_px) for x_px in ends_px))

    def show_frame(self) -> None:
        """Draw lines and curves again."""
        self._update_soon()

    def close(self) -> None:
        """Remove the lines: the window may outlive Python."""
        for tool in self._tools.values():
            tool.show_line(None)

    def _move_end(self, name: str, begin: QPointF, end: QPointF) -> None:
        plane = self._views.find_section_plane(name, self._session)
        if plane is not None:
            ends = (plane.backproject_to_mm(at.x() - 0.5, at.y() - 0.5) for at in (begin, end))
            self._controller.set_section(_make_line(*ends) or self._controller.section)

    def _show_change(self, line: SectionLine | None) -> None:
        self._last_line = line or self._last_line
        self._action.setChecked(line is not None)
        self._panel.show_line(line)
        if line is None:
            self._line_timer.stop()
            for tool in self._tools.values():
                tool.show_line(None)
        else:
            self._update_soon()

    def _update_soon(self, *_: object) -> None:
        if self._controller.section is not None and not self._line_timer.isActive():
            self._line_timer.start()

    def _show_line(self) -> None:
        """Draw the line in every image."""
        line = self._controller.section
        if line is None or self._controller.is_closed:
            return
        for name, tool in self._tools.items():
            plane = self._views.find_section_plane(name, self._session)
            ends = np.full((2, 2), np.nan)
            if plane is not None:
                ends = plane.project_to_px([line.begin_mm, line.end_mm]) + 0.5
            is_seen = bool(np.isfinite(ends).all())
            tool.show_line((QPointF(*ends[0]), QPointF(*ends[1])) if is_seen else None)
        if not self._curve_timer.isActive():
            self._curve_timer.start()

    def _show_curves(self) -> None:
        """Draw the curves along the line if the tab is visible."""
        line = self._controller.section
        if line is not None and self._panel.isVisible():
            maps = self._collect_height_maps()
            self._panel.show_section(cross_section.cut_section(line, maps) if maps else None)

    def _collect_height_maps(self) -> tuple[HeightMap, ...]:
        """Return the truth and every visible stage that has heights, in column order."""
        opened = self._translation
        views = self._views
        if opened is None:
            return ()
        source = views.get_shown_stage(SOURCE)
        truth = source.ground_truth if isinstance(source, SourcePreview) else None
        parts = {name: views.get_shown_stage(name) for name in self._window.visible_columns()}
        shown = [
            (name, part.preview, part.result.output if isinstance(part, StagePreview) else None)
            for name, part in parts.items()
            if part is not None and self._columns[name].state not in _OUTDATED
        ]
        return cross_section.collect_height_maps(opened, truth, shown, self._session.offsets)


def _make_line(begin_mm: tuple[float, float], end_mm: tuple[float, float]) -> SectionLine | None:
    """Round the ends to _DIGITS; None for a line that is too far away or a point."""
    numbers = np.round([*begin_mm, *end_mm], _DIGITS)
    if not np.isfinite(numbers).all() or np.abs(numbers).max() >= 1e3:
        return None
    x0, y0, x1, y1 = (float(n) for n in numbers)
    return SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1)) if (x0, y0) != (x1, y1) else None
