"""The way to a slot's value: curves over its kept steps, why it ended where it did, and any step to be looked at."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from PyQt6.QtCore import QPointF, QRectF, QSignalBlocker, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QPainter, QPalette, QPen
from PyQt6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from pipeline.stages.slot import Curve, Way
from widgets.colours import inks, qcolor
from widgets.looks import smaller, spaced

_LEFT_PX, _RIGHT_PX, _GAP_PX, _DOT_PX = 128.0, 14.0, 10.0, 2.5
_NOTHING = "Step through keeps the steps, which changes no answer, and shows them one by one"
KEEP, LET_GO = "Step through", "Keep no steps"


class StepsPlot(QWidget):
    """One strip a curve over the same steps; a click, a drag or the arrow keys choose a step."""

    step_chosen = pyqtSignal(int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("steps_plot")
        self.setAccessibleName("figures of every step")
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        smaller(self)
        self._curves: tuple[Curve, ...] = ()
        self._turns: tuple[int, ...] = ()
        self.at = -1

    def show_curves(self, curves: Sequence[Curve], turns: Sequence[int]) -> None:
        """These curves, with a line before each of the `turns`."""
        self._curves, self._turns = tuple(curves), tuple(turns)
        self.update()

    def show_at(self, at: int) -> None:
        """Mark a step."""
        if at != self.at:
            self.at = at
            self.update()

    @property
    def count(self) -> int:
        """Of the steps."""
        return len(self._curves[0].values) if self._curves else 0

    def sizeHint(self) -> QSize:  # noqa: N802
        """Room for three strips."""
        return QSize(400, 130)

    def x_of(self, at: int) -> float:
        """Where a step is across."""
        wide = self.width() - _LEFT_PX - _RIGHT_PX
        return _LEFT_PX + wide * at / max(1, self.count - 1)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Strips, marks and the step that is shown."""
        del a0
        if not self.count:
            return
        painter, palette = QPainter(self), self.palette()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        tall = (self.height() - _GAP_PX * (len(self._curves) + 1)) / len(self._curves)
        if 0 <= self.at < self.count:
            painter.setPen(QPen(qcolor(inks(palette).taken), 2))
            painter.drawLine(QPointF(self.x_of(self.at), 0), QPointF(self.x_of(self.at), self.height()))
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1, Qt.PenStyle.DashLine))
        for turn in self._turns:
            x = 0.5 * (self.x_of(turn - 1) + self.x_of(turn))
            painter.drawLine(QPointF(x, 0), QPointF(x, self.height()))
        for k, curve in enumerate(self._curves):
            top = _GAP_PX + k * (tall + _GAP_PX)
            self._draw(painter, curve, QRectF(_LEFT_PX, top, self.width() - _LEFT_PX - _RIGHT_PX, tall))

    def _draw(self, painter: QPainter, curve: Curve, room: QRectF) -> None:
        palette = self.palette()
        known = [value for value in curve.values if math.isfinite(value)]
        most = max(known, default=0.0) or 1.0
        painter.setPen(palette.color(QPalette.ColorRole.Mid))
        painter.drawLine(room.bottomLeft(), room.bottomRight())
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        words = QRectF(4, room.top() - 4, _LEFT_PX - 12, room.height() + 8)
        right = Qt.AlignmentFlag.AlignRight
        painter.drawText(words, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, curve.name)
        painter.drawText(words, right | Qt.AlignmentFlag.AlignTop, f"{most:.3g} {curve.unit}")
        painter.drawText(words, right | Qt.AlignmentFlag.AlignBottom, "0")
        dots = [
            QPointF(self.x_of(k), room.bottom() - room.height() * value / most)
            for k, value in enumerate(curve.values) if math.isfinite(value)
        ]  # fmt: skip
        ink = qcolor(inks(palette).soft)
        painter.setPen(QPen(ink, 1.5))
        for one, other in pairwise(dots):
            painter.drawLine(one, other)
        painter.setBrush(ink)
        for dot in dots:
            painter.drawEllipse(dot, _DOT_PX, _DOT_PX)

    def _choose(self, at: int) -> None:
        at = min(max(at, 0), self.count - 1)
        if self.count and at != self.at:
            self.step_chosen.emit(at)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Go to the step at this place."""
        wide = max(1.0, self.width() - _LEFT_PX - _RIGHT_PX)
        self._choose(round((a0.position().x() - _LEFT_PX) / wide * max(1, self.count - 1)))

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """The same with a button held: Qt tells of no other motions here."""
        self.mousePressEvent(a0)

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """One step on or back, or to an end."""
        ways = {Qt.Key.Key_Left: self.at - 1, Qt.Key.Key_Right: self.at + 1, Qt.Key.Key_Home: 0,
                Qt.Key.Key_End: self.count - 1}  # fmt: skip
        if a0.key() in ways:
            self._choose(ways[a0.key()])
        else:
            super().keyPressEvent(a0)


class StepsPanel(QWidget):
    """A chooser of the slot, a button that asks for its steps, a sentence, the plot, and the step in words."""

    slot_chosen = pyqtSignal()
    step_chosen = pyqtSignal(str, int)
    keep_wanted = pyqtSignal(str, bool)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.slots, self.keep, self.plot = QComboBox(), QPushButton(KEEP), StepsPlot()
        self._told, self._step = QLabel(_NOTHING), QLabel()
        self._way: Way | None = None
        self._kept = False
        self.slots.setObjectName("steps_slot")
        self.slots.setAccessibleName("slot that is stepped through")
        self.slots.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
        self.keep.setObjectName("steps_keep")
        self._told.setWordWrap(True)
        head = spaced(QHBoxLayout(), 8)
        for widget in (self.slots, self.keep):
            head.addWidget(widget)
        head.addWidget(self._told, 1)
        layout = spaced(QVBoxLayout(self), 2, (6, 4, 6, 4))
        layout.addLayout(head)
        layout.addWidget(self.plot, 1)
        layout.addWidget(self._step)
        self.slots.activated.connect(self._slot_chosen)
        self.keep.clicked.connect(lambda: self.keep_wanted.emit(self.slot, not self._kept))
        self.plot.step_chosen.connect(self._step_chosen)

    @property
    def slot(self) -> str:
        """The one that is chosen, "" for none."""
        return str(self.slots.currentData() or "")

    @property
    def told(self) -> str:
        """Why it ended, or what may be done."""
        return self._told.text()

    @property
    def step(self) -> str:
        """The step that is shown, in words."""
        return self._step.text()

    def _slot_chosen(self, _: int) -> None:
        self.slot_chosen.emit()

    def _step_chosen(self, at: int) -> None:
        self.step_chosen.emit(self.slot, at)

    def offer_slots(self, slots: Mapping[str, str]) -> None:
        """Name -> title of those whose way can be looked at."""
        names = list(slots)
        if [self.slots.itemData(i) for i in range(self.slots.count())] == names:
            return
        chosen = self.slot
        with QSignalBlocker(self.slots):
            self.slots.clear()
            for name in names:
                self.slots.addItem(slots[name], name)
            self.slots.setCurrentIndex(names.index(chosen) if chosen in names else len(names) - 1)

    def choose(self, slot: str) -> None:
        """Choose a slot without saying so to anybody."""
        with QSignalBlocker(self.slots):
            self.slots.setCurrentIndex(max(0, self.slots.findData(slot)))

    def show_way(self, way: Way | None, *, kept: bool, can: bool, why_not: str = "") -> None:
        """A slot's way, whether its steps are `kept` as things are set, and whether its method `can` keep some."""
        self._way, self._kept = way, kept
        self.keep.setText(LET_GO if kept else KEEP)
        self.keep.setEnabled(can)
        self._told.setText(way.told if way is not None else why_not or _NOTHING)
        self.plot.show_curves(() if way is None else way.curves, () if way is None else way.turns)
        self.show_at(-1 if way is None else len(way.steps) - 1)

    def show_at(self, at: int) -> None:
        """Mark a step, and say what is known of it."""
        self.plot.show_at(at)
        steps = () if self._way is None else self._way.steps
        self._step.setText(f"step {at + 1} of {len(steps)}: {steps[at]}" if 0 <= at < len(steps) else "")
