"""Notifications, never modal: a sentence with buttons of one action or menu each, stacked over
the page.
"""

from collections.abc import Callable, Sequence
from typing import Any

from PyQt6.QtCore import QEvent, QObject, QPoint, QSize, Qt
from PyQt6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QMenu,
    QPushButton,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from pipeline.core.errors import escape_text
from widgets.style.run_bar import RunBar
from widgets.style.styling import fill, make_single_shot_timer

Act = Callable[[], object]
# label, and what it does or the entries of its menu
Choice = tuple[str, Act | Sequence[tuple[str, Act]]]
_WIDTH_PX = 640
_AROUND_PX = 10
_BETWEEN_PX = 6


def make_choice_button(choice: Choice, then: Act) -> QPushButton:
    """Return a button that calls `then`, then acts.

    One with a menu does so with the chosen entry.
    """
    words, act = choice
    button = QPushButton(escape_text(words))
    button.setObjectName(f"offer_{words.split(maxsplit=1)[0].lower()}")

    def follow(chosen: Act) -> Callable[[], None]:
        def run() -> None:
            then()
            chosen()

        return run

    if callable(act):
        button.clicked.connect(follow(act))
        return button
    menu = QMenu(button)
    for text, chosen in act:
        action = menu.addAction(escape_text(text).replace("&", "&&"))
        assert action is not None
        action.triggered.connect(follow(chosen))
    button.setMenu(menu)
    return button


# until a notification leaves, without and with buttons
_READ_MS = 10_000
_ACT_MS = 20_000


class NotificationBar(QFrame):
    """Hidden until `show_notification`.

    Each button acts once and hides it. `run_bar` shows what the sentence is about.

    It leaves by itself after a time to read it, unless it is being read.
    """

    def __init__(self, name: str, *, read_ms: int = _READ_MS, choices_below: bool = False) -> None:
        super().__init__()
        self.setObjectName(name)
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.setAutoFillBackground(True)
        self._text = QLabel()
        self.run_bar = RunBar(name)
        self._away = QToolButton()
        self._text.setTextFormat(Qt.TextFormat.PlainText)  # file names are no markup
        self._text.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self._text.setWordWrap(True)
        self._away.setText("\N{MULTIPLICATION SIGN}")
        self._away.setAutoRaise(True)
        self._away.setToolTip("Dismiss")
        self._away.setAccessibleName("Dismiss")
        self._away.clicked.connect(self.hide)
        self._column = QVBoxLayout(self)
        self._row = QHBoxLayout()
        self._choices = QHBoxLayout()
        self._column.setContentsMargins(8, 3, 8, 3)
        fill(self._column, self._row)
        fill(self._row, (self._text, 1), self.run_bar)
        fill(self._column if choices_below else self._row, fill(self._choices, int(choices_below)))
        fill(self._row, self._away)
        self.buttons: list[QPushButton] = []
        self._read = make_single_shot_timer(self, read_ms, self._leave)
        self._read_ms = read_ms
        self.hide()

    @property
    def text(self) -> str:
        """The sentence on display."""
        return self._text.text()

    @property
    def is_being_read(self) -> bool:
        """Whether it does not leave now: the pointer is over it."""
        return self.underMouse()

    def show_notification(
        self, sentence: str, choices: Sequence[Choice] = (), *, stays: bool = False
    ) -> None:
        """Show one sentence and a button for each of `choices`.

        It does not leave while it `stays`.
        """
        for button in self.buttons:
            self._choices.removeWidget(button)
            button.deleteLater()
        self.buttons = [make_choice_button(choice, self.hide) for choice in choices]
        fill(self._choices, *self.buttons)
        self._text.setText(sentence[:1].upper() + sentence[1:])
        self.show()
        self.updateGeometry()
        self._read.stop() if stays else self._read.start(_ACT_MS if choices else self._read_ms)

    def _leave(self) -> None:
        self._read.start() if self.is_being_read else self.hide()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a narrow width: the sentence wraps."""
        return QSize(200, super().sizeHint().height())


class NotificationStack(QWidget):
    """Covers no more than the notifications need, at the lower right of `page` within `over`.

    Empty without any.
    """

    def __init__(self, over: QWidget, page: QWidget) -> None:
        super().__init__(over)
        self.setObjectName("notifications")
        self.setAccessibleName("notifications")
        self._page = page
        self._bars = list[QWidget]()
        self._place_soon = make_single_shot_timer(self, 0, self.place)
        for widget in (over, page):
            widget.installEventFilter(self)
        self.hide()

    def add_bar(self, bar: QWidget) -> None:
        """Add a notification; it is placed whenever it is visible, later ones lower."""
        is_hidden = bar.isHidden()
        bar.setParent(self)
        bar.setAutoFillBackground(True)
        bar.setHidden(is_hidden)
        bar.installEventFilter(self)
        self._bars.append(bar)

    def place(self) -> None:
        """Place the visible notifications, and this widget around them."""
        shown = [bar for bar in self._bars if not bar.isHidden()]
        self.setVisible(bool(shown))
        over = self.parentWidget()
        if not shown or over is None:
            return
        corner = self._page.mapTo(over, QPoint(self._page.width(), self._page.height()))
        width_px = max(1, min(_WIDTH_PX, self._page.width() - 2 * _AROUND_PX))
        top_px = 0
        for bar in shown:
            height_px = (
                bar.heightForWidth(width_px) if bar.hasHeightForWidth() else bar.sizeHint().height()
            )
            bar.setGeometry(0, top_px, width_px, height_px)
            top_px += height_px + _BETWEEN_PX
        height_px = top_px - _BETWEEN_PX
        self.setGeometry(
            corner.x() - _AROUND_PX - width_px,
            corner.y() - _AROUND_PX - height_px,
            width_px,
            height_px,
        )
        self.raise_()

    def eventFilter(self, a0: QObject | None, a1: Any) -> bool:  # noqa: N802
        """Place the notifications again when one changes, or what they lie on."""
        kind = None if a1 is None else a1.type()
        kinds = QEvent.Type
        if kind == kinds.ShowToParent and a0 in self._bars:
            self.place()
        elif kind in (kinds.HideToParent, kinds.LayoutRequest, kinds.Resize, kinds.Move):
            self._place_soon.start()
        return super().eventFilter(a0, a1)
