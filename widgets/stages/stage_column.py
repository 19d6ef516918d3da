"""Column of a stage: header with title, method, state and time, and the preview below."""

import math
import re
from collections.abc import Sequence
from functools import partial

from PyQt6.QtCore import QEvent, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QStandardItemModel
from PyQt6.QtWidgets import (
    QBoxLayout,
    QComboBox,
    QFrame,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from pipeline.stages.stage import TRUTH
from widgets.stages.pinned_parameters import PinnedParameters
from widgets.style.base import ChoiceBox, EventListener, FixedSizeLabel, resize_font
from widgets.style.icons import StateIcon
from widgets.style.styling import fill, make_bold, set_spacing
from widgets.style.theme import get_theme_colours, to_hex
from widgets.views.preview_view import PreviewView

_BETWEEN_PX = 40  # sign, text and time of a state, with margins
_SIGN_PX = 10  # between a title and the state's sign
_TITLE_PX = 120  # minimum width of a title next to other text
_METHOD_PX = 88  # minimum width of the method chooser next to the title
_AN_END = re.compile(
    r"[:;]|,(?!\d|[^(]*\))"
)  # end of the first part of a sentence; vectors and numbers such as 2,571 are one word


class StageColumn(QFrame):
    """Title, state (sign and text), milliseconds, preview; emits the pixel under the mouse."""

    pixel_hovered = pyqtSignal(str, int, int)  # stage, row, col; -1, -1 = none
    state_shown = pyqtSignal(str, tuple)  # with the warnings
    pixel_clicked = pyqtSignal(str, int, int)
    method_chosen = pyqtSignal(str, str)  # stage, method; "" = the route's own

    def __init__(self, name: str, title: str) -> None:  # noqa: PLR0915 - one statement a widget
        super().__init__()
        self.setObjectName(f"column_{name}")
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self._title = FixedSizeLabel(title)
        make_bold(self._title)
        resize_font(self._title)
        self._title.setToolTip(title)
        self._sign = StateIcon()
        self._word = QLabel()
        self._ms = QLabel()
        self._ms.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.view = PreviewView()
        self._first = set_spacing(QHBoxLayout(), 4)
        self._status = QWidget()
        fill(set_spacing(QHBoxLayout(self._status), 4), self._sign, self._word, (self._ms, 1))
        self._method = ChoiceBox(f"method_{name}", f"method of {title}")
        self._method.setSizeAdjustPolicy(
            QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
        )
        self._method.chosen.connect(partial(self.method_chosen.emit, name))
        self._unpin = QPushButton("Unpin")
        self._unpin.setObjectName(f"unpin_{name}")
        self._unpin.setToolTip("Compute this stage again in place of the recording's truth")
        self._unpin.clicked.connect(lambda: self.method_chosen.emit(name, ""))
        self._unpin.hide()
        self._only = QLabel()  # in place of the chooser where there is one method only
        for widget in (self._word, self._ms, self._method, self._only, self._unpin):
            resize_font(widget)
        self._unpin.setFixedHeight(self._title.sizeHint().height())  # previews stay aligned
        self._only.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._only.setFixedHeight(self._method.sizeHint().height())
        self._method.hide()
        self._head = QBoxLayout(QBoxLayout.Direction.TopToBottom)
        self._head.setSpacing(2)
        fill(self._first, (self._title, 1), self._unpin)
        fill(self._head, self._first, self._only, self._method, self._status)
        self._note = FixedSizeLabel()
        self._note.setObjectName(f"note_{name}")
        resize_font(self._note)
        self._note.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
        self._wide = self._joined = False
        self._show_lines(2)
        self.pinned = PinnedParameters()
        layout = set_spacing(QVBoxLayout(self), 1, (1, 2, 1, 1))
        fill(layout, self._head, (self.view, 1), self._note, self.pinned)
        self.setMinimumWidth(90)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Expanding)
        self.state = ""
        self.warnings = tuple[str, ...]()
        self._notes = tuple[str, ...]()
        self.view.pixel_hovered.connect(partial(self.pixel_hovered.emit, name))
        self.view.pixel_clicked.connect(partial(self.pixel_clicked.emit, name))
        self.show_state("waiting")
        EventListener(self, self._fit_time, QEvent.Type.Resize)

    def set_wide(self, wide: bool) -> None:
        """Place title, method and state in one row if wide, else in several."""
        way = QBoxLayout.Direction
        self._head.setDirection(way.LeftToRight if wide else way.TopToBottom)
        self._head.setSpacing(10 if wide else 2)
        self._head.setStretchFactor(self._first, 2 if wide else 0)
        for place in (self._only, self._method):
            self._head.setStretchFactor(place, 2 if wide else 0)
        self._title.setMinimumWidth(min(self._title_px + 1, _TITLE_PX) if wide else 0)
        self._wide = wide
        self.pinned.set_wide(wide)
        self.set_compact(False)
        self._fit_time()

    def set_compact(self, short: bool, *, joined: bool = False) -> None:
        """Give caption, note and pinned parameters one line each, and the colour bar no histogram.

        `joined` puts the state into the title's line.
        """
        self._show_lines(1 if short or self._wide else 2)
        self.view.colour_bar.set_compact(short)
        self.pinned.set_compact(short)
        joined = joined and not self._wide
        if joined != self._joined:
            self._joined = joined
            (self._first if joined else self._head).addWidget(self._status)
            self._fit_time()

    @property
    def has_room_for_state(self) -> bool:
        """Return whether the state's sign fits next to the whole title."""
        return self.width() >= self._title_px + self._sign.sizeHint().width() + _SIGN_PX

    @property
    def _title_px(self) -> int:
        return self._title.fontMetrics().horizontalAdvance(self._title.text())

    def _show_lines(self, lines: int) -> None:
        """Reserve the lines of caption and note whether they are used or not: previews stay
        aligned.
        """
        self.view.caption.set_lines(lines)
        self._note.set_lines(lines)

    def _fit_time(self) -> None:
        at_side = self._head.direction() == QBoxLayout.Direction.LeftToRight
        before = self._title.minimumWidth() + _METHOD_PX if at_side else 0
        if self._joined:
            before = self._title_px
        words = before + (0 if self._joined else self._word.sizeHint().width())
        room = self.width() - self._sign.sizeHint().width() - _BETWEEN_PX
        self._ms.setHidden(room < words + self._ms.sizeHint().width())
        self._word.setHidden(self._joined or (at_side and room < words))
        hidden = self._ms.isHidden() or self._word.isHidden()
        timed = (
            [f"{self.state}, {self._ms.text()}" if self._ms.text() else self.state]
            if hidden
            else []
        )
        tip = "\n".join([*timed, *self._notes])
        for label in (self._sign, self._word, self._ms, self._note):
            label.setToolTip(tip)

    def offer_methods(self, methods: Sequence[tuple[str, str, str]]) -> None:
        """Offer (name, title, help) of the methods of this stage; a single one is a label."""
        tips = {name: tip for name, _, tip in methods}
        self._method.offer({name: title for name, title, _ in methods}, tips=tips)
        several = len(methods) > 1
        self._method.setVisible(several)
        self._only.setVisible(not several)
        self._only.setText("" if several or not methods else methods[0][1])
        self._only.setToolTip("" if several or not methods else methods[0][2])

    def enable_method(self, name: str, enabled: bool) -> None:
        """Let a method be chosen, or not."""
        model = self._method.model()
        index = self._method.findData(name)
        item = model.item(index) if isinstance(model, QStandardItemModel) and index >= 0 else None
        if item is not None:
            item.setEnabled(enabled)

    def show_method(self, name: str) -> None:
        """Show the selected method without emitting a signal."""
        index = self._method.findData(name)
        with QSignalBlocker(self._method):
            self._method.setCurrentIndex(index)
        self._method.setToolTip(
            str(self._method.itemData(index, Qt.ItemDataRole.ToolTipRole) or "")
        )
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

        Notes become the tooltip, and the reason over a skipped preview.

        The badge, or else the first note up to its first colon or comma, is shown below the
        preview.
        """
        if state != self.state:
            self.state = state
            self._sign.show_state(state)
            self._word.setText(state)
        self._ms.setText("" if ms is None else _time_text(ms))
        self._notes = notes
        self._fit_time()
        if state not in ("stale", "running"):
            first = notes[0] if notes and state not in ("skipped", "failed") else ""
            self._note.setText(badge or _AN_END.split(first, maxsplit=1)[0])
        old = state in ("stale", "running", "failed") and self.view.preview is not None
        self.view.canvas.set_dimmed(old)
        self.view.show_message(self._message(state, notes))
        self.state_shown.emit(state, self.warnings)

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

    def compute_preferred_height_px(self) -> int:
        """Return the height at which the preview fills the column's width."""
        room = self.view.canvas.size()
        return self.height() - room.height() + math.ceil(room.width() * self.view.height_over_width)

    def _message(self, state: str, notes: tuple[str, ...]) -> str:
        if state in ("stale", "running"):
            return "updating" if self.view.preview is not None else "working…"
        if state == "skipped":
            return notes[0] if notes else "not needed for this frame"
        if state == "failed":
            return notes[0] if notes else "failed"
        return ""


def _time_text(ms: float) -> str:
    if ms < 10:
        return f"{ms:.2f} ms"
    return f"{ms:.0f} ms" if ms < 10_000 else f"{ms / 1e3:.1f} s"
