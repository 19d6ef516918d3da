"""Small widgets and tools that the others are built from: painting, events, letters, labels,
choices, numbers.
"""

from collections.abc import Callable, Mapping
from typing import Any

from PyQt6.QtCore import QEvent, QObject, QSignalBlocker, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QPainter, QValidator
from PyQt6.QtWidgets import (
    QApplication,
    QComboBox,
    QDoubleSpinBox,
    QFrame,
    QLabel,
    QScrollArea,
    QSizePolicy,
    QStyle,
    QStyleOptionComboBox,
    QStylePainter,
    QWidget,
)

from widgets.style.theme import ThemeColours, get_theme_colours

_Policy = QSizePolicy.Policy
# how a widget takes width or height
GROWS = _Policy.Expanding
FIXED = _Policy.Fixed
YIELDS = _Policy.Ignored
PREFERS = _Policy.Preferred
_UNDER_PX = 2


class EventListener(QObject):
    """Calls `then` at events of these kinds of a widget, before the widget handles them.

    Lives as long as it.
    """

    def __init__(self, widget: QWidget, then: Callable[[], object], *kinds: QEvent.Type) -> None:
        super().__init__(widget)
        self._then = then
        self._kinds = kinds
        widget.installEventFilter(self)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Call the function."""
        del a0
        if a1 is not None and a1.type() in self._kinds:
            self._then()
        return False


class PaintedWidget(QWidget):
    """Paints itself in the theme's colours.

    Subclasses have a preferred size and override `paint`.
    """

    preferred_px = 200, 160  # width, height

    def __init__(
        self, name: str = "", description: str = "", across: _Policy = GROWS, down: _Policy = GROWS
    ) -> None:
        """`name` finds the widget, `description` is what a screen reader says."""
        super().__init__()
        self.setObjectName(name)
        self.setAccessibleName(description)
        self.setSizePolicy(across, down)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the preferred size."""
        return QSize(*self.preferred_px)

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint in the theme's colours."""
        raise NotImplementedError

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint."""
        del a0
        self.paint(QPainter(self), get_theme_colours(self.palette()))


TEXT_PT = 10.0  # size of all text but figures and the title of the welcome page


def set_text_size() -> None:
    """Set the size of the letters of the application, unless it is set already."""
    font = QApplication.font()
    if font.pointSizeF() != TEXT_PT:
        font.setPointSizeF(TEXT_PT)
        QApplication.setFont(font)


def enlarge_font(widget: QWidget, by_pt: float) -> None:
    """Make a widget's font larger than the window's."""
    font = widget.font()
    font.setPointSizeF(font.pointSizeF() + by_pt)
    widget.setFont(font)


class VerticalScrollArea(QScrollArea):
    """Cuts nothing off at its sides; call `updateGeometry` when the content becomes wider."""

    def __init__(self) -> None:
        super().__init__()
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the width of the content next to a scroll bar."""
        hint = super().minimumSizeHint()
        body = self.widget()
        bar = self.verticalScrollBar()
        if body is None or bar is None:
            return hint
        return QSize(body.minimumSizeHint().width() + bar.sizeHint().width(), hint.height())


class FixedSizeLabel(QLabel):
    """Plain text in the available room: one line is elided, several lines wrap."""

    def __init__(self, text: str = "") -> None:
        super().__init__()
        self._said = text
        self._lines = 1
        self.setSizePolicy(YIELDS, FIXED)
        self.setTextFormat(Qt.TextFormat.PlainText)

    def text(self) -> str:
        """The whole text."""
        return self._said

    def setText(self, a0: str | None) -> None:  # noqa: N802
        """Show another text."""
        if (a0 or "") != self._said:
            self._said = a0 or ""
            self.update()

    def set_lines(self, lines: int) -> None:
        """Reserve room for this many lines, needed or not; shrinks to one if there is no room."""
        if lines != self._lines:
            self._lines = lines
            self.setWordWrap(lines > 1)
            policy = _Policy.Maximum if lines > 1 else FIXED
            self.setSizePolicy(YIELDS, policy)
            self.updateGeometry()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the height of the lines at any width."""
        return QSize(0, self._lines * self.fontMetrics().lineSpacing() + _UNDER_PX)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the height of one line."""
        return QSize(0, self.fontMetrics().lineSpacing() + _UNDER_PX)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint the text."""
        del a0
        painter = QPainter(self)
        room = self.contentsRect()
        how = self.alignment()
        painter.setPen(self.palette().color(self.foregroundRole()))
        if self.wordWrap():
            painter.drawText(room, int(how) | int(Qt.TextFlag.TextWordWrap), self._said)
        else:
            end = Qt.TextElideMode.ElideRight
            painter.drawText(
                room, int(how), self.fontMetrics().elidedText(self._said, end, room.width())
            )


class ChoiceBox(QComboBox):
    """Offers names by their texts.

    A text that does not fit ends in dots. `chosen` carries what the user chose.
    """

    chosen = pyqtSignal(str)

    def __init__(
        self,
        name: str,
        description: str,
        choices: Mapping[str, str] | None = None,
        *,
        is_narrow: bool = False,
    ) -> None:
        """`name` finds the box, `description` is what a screen reader says.

        A narrow one does not ask for the room of its longest text.
        """
        super().__init__()
        self.setObjectName(name)
        self.setAccessibleName(description)
        how = QComboBox.SizeAdjustPolicy
        self.setSizeAdjustPolicy(
            how.AdjustToMinimumContentsLengthWithIcon if is_narrow else how.AdjustToContents
        )
        self.offer(choices or {})
        self.activated.connect(lambda: self.chosen.emit(self.choice))

    @property
    def choice(self) -> str:
        """Name of the current choice; "" for none."""
        return str(self.currentData() or "")

    def offer(
        self,
        choices: Mapping[str, str],
        chosen: str | None = None,
        tips: Mapping[str, str] | None = None,
    ) -> None:
        """Offer name -> text and show `chosen`, by default the choice before, else the first.

        Emits no signal.

        `tips` are tooltips by name.
        """
        chosen = self.choice if chosen is None else chosen
        with QSignalBlocker(self):
            if [self.itemData(i) for i in range(self.count())] != list(choices):
                self.clear()
                for name, text in choices.items():
                    self.addItem(text, name)
                    self.setItemData(
                        self.count() - 1, (tips or {}).get(name), Qt.ItemDataRole.ToolTipRole
                    )
            self.choose(chosen)

    def choose(self, name: str) -> None:
        """Choose a name, the first one for another."""
        self.setCurrentIndex(max(0, self.findData(name)))

    def paintEvent(self, e: Any) -> None:  # noqa: N802
        """Paint the box with the part of the text that fits."""
        del e
        painter = QStylePainter(self)
        option = QStyleOptionComboBox()
        style = self.style()
        self.initStyleOption(option)
        if style is not None:
            part = QStyle.SubControl.SC_ComboBoxEditField
            room = style.subControlRect(QStyle.ComplexControl.CC_ComboBox, option, part, self)
            icon_px = 0 if option.currentIcon.isNull() else option.iconSize.width() + 4
            end = Qt.TextElideMode.ElideRight
            option.currentText = option.fontMetrics.elidedText(
                option.currentText, end, room.width() - icon_px - 2
            )
        painter.drawComplexControl(QStyle.ComplexControl.CC_ComboBox, option)
        painter.drawControl(QStyle.ControlElement.CE_ComboBoxLabel, option)


class NumberBox(QDoubleSpinBox):
    """Writes a decimal point, as every figure of the window has, and takes a typed comma for
    one.
    """

    def __init__(
        self, low: float = 0.0, high: float = 99.0, step: float = 1.0, decimals: int = 2
    ) -> None:
        super().__init__()
        self.setDecimals(decimals)
        self.setRange(low, high)
        self.setSingleStep(step)
        self.setKeyboardTracking(False)

    def validate(self, input: str | None, pos: int) -> tuple[QValidator.State, str, int]:  # noqa: A002 - Qt's name
        """Return whether the text is a number, and the text with a point.

        Without this, 2,5 became 25.
        """
        return super().validate((input or "").replace(",", "."), pos)
