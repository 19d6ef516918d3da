"""The section line: laid through every picture in millimetres, and its curves in a tab. Off, it costs nothing."""

from __future__ import annotations

from functools import partial

import numpy as np
from PyQt6.QtCore import QEvent, QObject, QPointF

from app.window.session_controller import SessionController
from app.work.stage_previews import SourcePreview, StagePreview
from pipeline.stages.stage import SensorRole
from pipeline.translation import cross_section
from pipeline.translation.cross_section import HeightMap, SectionLine, SectionPlane
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap
from widgets.section_line_tool import SectionLineTool
from widgets.styling import make_single_shot_timer

_AFTER_MS = 15  # parts of one frame, and events of one drag, are drawn together
_SHARE = 0.9  # of the source's width that the first line takes
_ROUND = 2  # digits of a millimetre
_OLD = ("failed", "waiting")  # states of columns whose picture is not of this frame
_TRUTH = "truth"  # the column that demonstrations have besides


class SectionLineController(QObject):
    """Between the pictures, the tab, the command and the line of the controller."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._panel, self._action = self._window.section_panel, self._window.actions_by_name["section_line"]
        self._last: SectionLine | None = None  # that was laid before it was taken away
        self._views = {name: column.view for name, column in self._window.columns.items()}
        self._views[_TRUTH] = self._window.truth_column.view
        self._hands = {name: SectionLineTool(view.canvas) for name, view in self._views.items()}
        for name, hand in self._hands.items():
            hand.line_moved.connect(partial(self._dragged, name))
        # Two events, so that neither keeps the window's thread for long: pictures first, then the curves.
        self._soon, self._then = (
            make_single_shot_timer(self, _AFTER_MS, self._show),
            make_single_shot_timer(self, _AFTER_MS, self._cut),
        )
        self._panel.line_typed.connect(controller.set_section)
        self._panel.add_command(self._action)
        self._panel.installEventFilter(self)
        self._window.connect_command("section_line", self._toggle)
        controller.section_changed.connect(self._moved)
        controller.job.delivered.connect(self._delivered)
        controller.frame_shown.connect(self._delivered)
        controller.closing.connect(self._close)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Nothing is cut while nobody sees the tab."""
        if a1 is not None and a1.type() == QEvent.Type.Show:
            self._delivered()
        return super().eventFilter(a0, a1)

    def _toggle(self) -> None:
        controller, window = self._controller, self._window
        if controller.section is not None:
            controller.set_section(None)
            return
        line = self._last or self._first()
        if line is None:  # nothing is open
            self._action.setChecked(False)
            return
        controller.set_section(line)
        window.drawers.diagnostics.show()
        window.drawers.diagnostics.raise_()
        window.tabs.setCurrentWidget(self._panel)

    def _first(self) -> SectionLine | None:
        """Across the source, through where it is pushed in deepest."""
        opened = self._controller.views.translation
        if opened is None:
            return None
        camera, part = opened.source.camera, self._controller.views.get_shown_stage("depth")
        x_px, y_px = 0.5 * (camera.cols - 1), 0.5 * (camera.rows - 1)
        depth = part.result.output if isinstance(part, StagePreview) else None
        if isinstance(depth, DepthMap) and depth.contact.any():
            inside = np.where(depth.contact, depth.indentation_mm, -np.inf)
            camera, y_px = depth.camera, float(np.nanargmax(inside) // depth.camera.cols)
            x_px = 0.5 * (camera.cols - 1)
        sheet = cross_section.build_plane(opened, "source", camera)
        reach_px = 0.5 * _SHARE * camera.cols
        return _line(sheet.backproject_to_mm(x_px - reach_px, y_px), sheet.backproject_to_mm(x_px + reach_px, y_px))

    def _close(self) -> None:
        """Listen to no picture any more: the window may outlive Python."""
        for timer in (self._soon, self._then):
            timer.stop()
        for hand in self._hands.values():
            hand.show_line(None)

    def _dragged(self, name: str, begin: QPointF, end: QPointF) -> None:
        sheet = self._sheet(name)
        if sheet is not None:
            line = _line(*(sheet.backproject_to_mm(at.x() - 0.5, at.y() - 0.5) for at in (begin, end)))
            if line is not None:
                self._controller.set_section(line)

    def _moved(self, line: SectionLine | None) -> None:
        self._last = line or self._last
        self._action.setChecked(line is not None)
        self._panel.show_line(line)
        if line is None:
            self._soon.stop()
            for hand in self._hands.values():
                hand.show_line(None)
        else:
            self._delivered()

    def _delivered(self, *_: object) -> None:
        if self._controller.section is not None and not self._soon.isActive():
            self._soon.start()

    def _show(self) -> None:
        """The line in every picture."""
        line = self._controller.section
        if line is None or self._controller.is_closed:
            return
        for name, hand in self._hands.items():
            sheet = self._sheet(name)
            ends = None if sheet is None else sheet.project_to_px(np.array([line.begin_mm, line.end_mm])) + 0.5
            known = ends is not None and bool(np.isfinite(ends).all())
            hand.show_line((QPointF(*ends[0]), QPointF(*ends[1])) if ends is not None and known else None)
        if not self._then.isActive():
            self._then.start()

    def _cut(self) -> None:
        """The curves along the line, where somebody sees them."""
        line = self._controller.section
        if line is not None and self._panel.isVisible():
            fields = self._fields()
            self._panel.show_section(cross_section.cut_section(line, fields) if fields else None)

    def _fields(self) -> tuple[HeightMap, ...]:
        """What is true, then whatever is worked out and has heights, in the order of the columns."""
        opened, screen = self._controller.views.translation, self._controller.views
        if opened is None:
            return ()
        source = screen.get_shown_stage(SOURCE)
        facts = source.ground_truth if isinstance(source, SourcePreview) else None
        parts = {
            name: screen.get_shown_stage(name) for name in self._window.visible_columns()
        }  # others' may be of another frame
        shown = [
            (name, part.preview, part.result.output if isinstance(part, StagePreview) else None)
            for name, part in parts.items()
            if part is not None and self._window.columns[name].state not in _OLD
        ]
        return cross_section.collect_height_maps(opened, facts, shown, self._controller.session.offsets)

    def _sheet(self, name: str) -> SectionPlane | None:
        """The plane of the line as a column's picture has it."""
        opened, picture = self._controller.views.translation, self._views[name].preview
        if opened is None or picture is None:
            return None
        place = "target" if name == _TRUTH else _place(opened, name)
        camera = cross_section.find_image_camera(picture, opened.source if place == "source" else opened.target)
        return cross_section.build_plane(opened, place, camera, self._controller.session.offsets)


def _place(opened: Translation, name: str) -> SensorRole:
    return "source" if name == SOURCE else opened.catalogue.stage(name).sensor_role


def _line(begin_mm: tuple[float, float], end_mm: tuple[float, float]) -> SectionLine | None:
    """To what the tab can say; None where it would be nowhere, or no line."""
    numbers = np.round([*begin_mm, *end_mm], _ROUND)
    if not np.isfinite(numbers).all() or np.abs(numbers).max() >= 1e3:
        return None
    x0, y0, x1, y1 = (float(n) for n in numbers)
    return SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1)) if (x0, y0) != (x1, y1) else None
