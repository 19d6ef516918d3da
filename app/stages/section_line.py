"""The section line through all images, in millimetres, and the height curves along it in a tab."""

from functools import partial

import numpy as np
from PyQt6.QtCore import QEvent, QPointF

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.stage_previews import SourcePreview, StagePreview
from pipeline.core.values.results import DepthMap
from pipeline.translation import cross_section
from pipeline.translation.cross_section import HeightMap, SectionLine, SectionPlane
from pipeline.translation.pixel_trace import SOURCE
from widgets.stages.section_panel import SectionLineTool
from widgets.style.base import EventListener
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 15  # updates within it are drawn together
_DEFAULT_SHARE = 0.9  # of the source's width, for the default line
_DIGITS = 2  # decimals of a coordinate in mm
_OUTDATED = ("failed", "waiting")  # column states of another frame


class SectionLineController(Feature):
    """Connects the images, the tab, the command and the session's section line."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel, self._action = (
            self._window.section_panel,
            self._window.actions_by_name["section_line"],
        )
        self._last_line: SectionLine | None = None  # before it was removed
        self._views = {name: column.view for name, column in self._window.columns.items()}
        self._tools = {name: SectionLineTool(view.canvas) for name, view in self._views.items()}
        for name, tool in self._tools.items():
            tool.line_moved.connect(partial(self._move_end, name))
        # Two timers, so that neither blocks the window for long: lines first, then curves.
        self._line_timer, self._curve_timer = (
            make_single_shot_timer(self, _DELAY_MS, self._show_line),
            make_single_shot_timer(self, _DELAY_MS, self._show_curves),
        )
        self._panel.line_typed.connect(controller.set_section)
        self._panel.add_command(self._action)
        EventListener(self._panel, self._update_soon, QEvent.Type.Show)
        self._window.connect_command("section_line", self._toggle)
        controller.section_changed.connect(self._show_change)
        controller.job.delivered.connect(self._update_soon)
        controller.frame_shown.connect(self._update_soon)
        controller.closing.connect(self._close)

    def _toggle(self) -> None:
        controller = self._controller
        window = self._window
        if controller.section is not None:
            controller.set_section(None)
            return
        line = self._last_line or self._make_default_line()
        if line is None:  # nothing is open
            self._action.setChecked(False)
            return
        controller.set_section(line)
        window.show_diagnostics(self._panel)

    def _make_default_line(self) -> SectionLine | None:
        """Return a horizontal line on the source through the deepest indentation.

        None if nothing is open.
        """
        opened = self._controller.views.translation
        if opened is None:
            return None
        camera = opened.source.camera
        part = self._controller.views.get_shown_stage("depth")
        x_px = 0.5 * (camera.cols - 1)
        y_px = 0.5 * (camera.rows - 1)
        depth = part.result.output if isinstance(part, StagePreview) else None
        if isinstance(depth, DepthMap) and depth.contact.any():
            inside = np.where(depth.contact, depth.indentation_mm, -np.inf)
            camera = depth.camera
            y_px = float(np.nanargmax(inside) // depth.camera.cols)
            x_px = 0.5 * (camera.cols - 1)
        plane = cross_section.build_plane(opened, "source", camera)
        reach_px = 0.5 * _DEFAULT_SHARE * camera.cols
        return _make_line(
            plane.backproject_to_mm(x_px - reach_px, y_px),
            plane.backproject_to_mm(x_px + reach_px, y_px),
        )

    def _close(self) -> None:
        """Remove the lines: the window may outlive Python."""
        for tool in self._tools.values():
            tool.show_line(None)

    def _move_end(self, name: str, begin: QPointF, end: QPointF) -> None:
        plane = self._get_plane(name)
        if plane is not None:
            line = _make_line(
                *(plane.backproject_to_mm(at.x() - 0.5, at.y() - 0.5) for at in (begin, end))
            )
            if line is not None:
                self._controller.set_section(line)

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
            plane = self._get_plane(name)
            ends = (
                None
                if plane is None
                else plane.project_to_px(np.array([line.begin_mm, line.end_mm])) + 0.5
            )
            is_finite = ends is not None and bool(np.isfinite(ends).all())
            tool.show_line(
                (QPointF(*ends[0]), QPointF(*ends[1])) if ends is not None and is_finite else None
            )
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
        opened = self._controller.views.translation
        views = self._controller.views
        if opened is None:
            return ()
        source = views.get_shown_stage(SOURCE)
        truth = source.ground_truth if isinstance(source, SourcePreview) else None
        parts = {name: views.get_shown_stage(name) for name in self._window.visible_columns()}
        shown = [
            (name, part.preview, part.result.output if isinstance(part, StagePreview) else None)
            for name, part in parts.items()
            if part is not None and self._window.columns[name].state not in _OUTDATED
        ]
        return cross_section.collect_height_maps(
            opened, truth, shown, self._controller.session.offsets
        )

    def _get_plane(self, name: str) -> SectionPlane | None:
        """Return the section plane of a column's image; None if it is empty."""
        opened = self._controller.views.translation
        preview = self._views[name].preview
        if opened is None or preview is None:
            return None
        role = opened.get_role(name)
        camera = cross_section.find_image_camera(
            preview, opened.source if role == "source" else opened.target
        )
        return cross_section.build_plane(opened, role, camera, self._controller.session.offsets)


def _make_line(begin_mm: tuple[float, float], end_mm: tuple[float, float]) -> SectionLine | None:
    """Round the ends to _DIGITS; None for a line that is too far away or a point."""
    numbers = np.round([*begin_mm, *end_mm], _DIGITS)
    if not np.isfinite(numbers).all() or np.abs(numbers).max() >= 1e3:
        return None
    x0, y0, x1, y1 = (float(n) for n in numbers)
    return SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1)) if (x0, y0) != (x1, y1) else None
