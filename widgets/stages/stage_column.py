"""One stage, large: title, method and state over its preview."""

from collections.abc import Sequence
from functools import partial

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QPalette, QStandardItemModel
from PyQt6.QtWidgets import (
    QBoxLayout,
    QFrame,
    QLabel,
    QWidget,
)

from pipeline.core.errors import name_options
from pipeline.stages.stage import TRUTH
from widgets.style.base import FIXED, GROWS, YIELDS, ChoiceBox
from widgets.style.icons import PENDING, StateIcon, is_trouble
from widgets.style.styling import fill, format_time, make_bold, make_button, make_column, make_row
from widgets.style.theme import get_theme_colours, to_hex
from widgets.views.preview_view import PreviewView

_LINE_PX = 2
_METHOD_PX = 48  # least width of the chooser


class StageColumn(QFrame):
    """Title, method, sign of a trouble, preview; emits the pixel under the mouse."""

    pixel_hovered = pyqtSignal(str, int, int)  # stage, row, col; -1, -1 = none
    state_shown = pyqtSignal(str, str)  # and all that is known of it, for a tooltip
    pixel_clicked = pyqtSignal(str, int, int)
    method_chosen = pyqtSignal(str, str)  # stage, method; "" = the route's own

    def __init__(self, name: str, title: str) -> None:
        super().__init__()
        self.setObjectName(f"column_{name}")
        self.title = title
        self._title = make_bold(QLabel(title))
        self._sign = StateIcon()
        self.view = PreviewView()
        self.view.remark.setObjectName(f"note_{name}")
        self.view.caption.set_lines(1)
        self.view.text_layout.setDirection(QBoxLayout.Direction.LeftToRight)
        self.view.text_layout.setStretch(0, 2)
        self.view.text_layout.setStretch(1, 3)
        self.view.shape_changed.connect(self._fit_text)
        self._method = ChoiceBox(f"method_{name}", f"method of {title}", is_narrow=True)
        self._method.chosen.connect(partial(self.method_chosen.emit, name))
        self._method.hide()
        tip = "Compute this stage again in place of the recording's truth"
        self._unpin = make_button("Unpin", f"unpin_{name}", tip)
        self._unpin.clicked.connect(lambda: self.method_chosen.emit(name, ""))
        self._unpin.hide()
        self.head = QWidget()  # a pane shows it over image and 3D view
        self._method.setSizePolicy(YIELDS, FIXED)
        self._method.setMinimumWidth(_METHOD_PX)
        self._line = QFrame()  # while the stage is computed again
        self._line.setFixedHeight(_LINE_PX)
        self._line.setBackgroundRole(QPalette.ColorRole.Link)
        row = make_row(4, around_px=(4, 0, 0, 0))
        fill(row, self._title, (self._method, 1), self._unpin, self._sign)
        make_column(0, (row, 1), self._line, on=self.head)
        make_column(0, self.head, (self.view, 1), on=self)
        self.setSizePolicy(YIELDS, GROWS)
        self.state = ""
        self.warnings = tuple[str, ...]()
        self.view.pixel_hovered.connect(partial(self.pixel_hovered.emit, name))
        self.view.pixel_clicked.connect(partial(self.pixel_clicked.emit, name))
        self.show_state("waiting")

    def _fit_text(self) -> None:
        """Give an image in true colours all the room: its caption is the tooltip."""
        self.view.text_area.setVisible(self.view.has_colour_scale)
        preview = self.view.preview
        self.view.canvas.setToolTip("" if preview is None else preview.caption)

    def offer_methods(self, methods: Sequence[tuple[str, str, str]]) -> None:
        """Offer (name, title, help) of the methods of this stage, if there are several."""
        tips = {name: tip for name, _, tip in methods}
        self._method.offer({name: title for name, title, _ in methods}, tips=tips)
        self._method.setVisible(len(methods) > 1)

    @property
    def method_title(self) -> str:
        """Title of the method in use; "" where there is no choice."""
        return self._method.currentText()

    def enable_method(self, name: str, enabled: bool) -> None:
        """Let a method be chosen, or not."""
        model = self._method.model()
        if isinstance(model, QStandardItemModel):
            item = model.item(self._method.findData(name))
            if item is not None:
                item.setEnabled(enabled)

    def show_method(self, name: str) -> None:
        """Show the selected method without emitting a signal."""
        index = self._method.findData(name)
        with QSignalBlocker(self._method):
            self._method.setCurrentIndex(index)
        tip = self._method.itemData(index, Qt.ItemDataRole.ToolTipRole) or ""
        self._method.setToolTip(f"{self.method_title}\n{tip}".strip())  # a long title is cut
        is_pinned = name == TRUTH
        if is_pinned == self._unpin.isHidden():
            self._unpin.setVisible(is_pinned)
            colour = to_hex(get_theme_colours(self.palette()).states["warning"])
            frame = f"#{self.objectName()} {{ border: 2px solid {colour}; }}"
            self.setStyleSheet(frame if is_pinned else "")

    def show_state(
        self, state: str, ms: float | None = None, notes: tuple[str, ...] = (), badge: str = ""
    ) -> None:
        """Show the state of the stage.

        Time and notes become the tooltip, and the first one the reason over a skipped preview. The
        badge is shown in the head. What is on screen stays as it is until the next result.
        """
        self.state = state
        notes = tuple(name_options(note) for note in notes)
        self._sign.show_state(state)
        self._sign.setVisible(is_trouble(state))
        known = filter(None, (self.title, state, "" if ms is None else format_time(ms)))
        tip = "\n".join((", ".join(known), *notes))
        for label in (self._title, self._sign, self.view.remark):
            label.setToolTip(tip)
        if state not in PENDING:
            self.view.remark.setText(badge)
            self.view.remark.setVisible(bool(badge))
        self._line.setAutoFillBackground(state in PENDING)
        self.view.show_message(self._explain_empty(state, notes))
        self.state_shown.emit(state, tip)

    def show_result(
        self,
        state: str,
        ms: float,
        notes: tuple[str, ...],
        warnings: tuple[str, ...],
        badge: str = "",
        *,
        is_fallback: bool = False,
    ) -> None:
        """Show a result; warnings come before other notes, and they or a fallback set the state,
        unless a draft.
        """
        plain = tuple(note for note in notes if note not in warnings)
        self.warnings = warnings
        warns = (bool(warnings) or is_fallback) and state != "draft"
        self.show_state("warning" if warns else state, ms, (*warnings, *plain), badge)

    def _explain_empty(self, state: str, notes: tuple[str, ...]) -> str:
        if state in PENDING and self.view.preview is None:
            return "working…"
        whys = {"skipped": "not needed for this frame", "failed": "failed"}
        return (*notes, whys[state])[0] if state in whys else ""
