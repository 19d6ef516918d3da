"""Every control has a name and large enough letters, is reached by the tab key, and Qt has
nothing to complain about.
"""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt, qInstallMessageHandler
from PyQt6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSlider,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QMenu,
    QMenuBar,
    QPlainTextEdit,
    QScrollBar,
    QTabBar,
    QToolBar,
    QToolButton,
    QWidget,
)

from app.session.layout import LAYOUT_NAMES
from app.shell.tour import wait_until_shown
from widgets.style.base import TEXT_PT

LIMIT_S = 240
_CONTROLS = (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSlider,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QPlainTextEdit,
)
# a scroll bar or header belongs to its view; a tab is named by its text
_PARTS = (QScrollBar, QHeaderView, QTabBar)
DIALOGS = ("palette", "export", "live")


@pytest.fixture
def opened(bubble_window):
    """A window with every dialog made."""
    for name in DIALOGS:
        bubble_window.window.actions_by_name[name].trigger()
    return bubble_window.window


def _widgets():
    return [
        widget
        for top in QApplication.topLevelWidgets()
        for widget in (top, *top.findChildren(QWidget))
    ]


def _is_part(widget) -> bool:
    """Whether it is a part of another control: the line of a spin box, the button in a line, the
    list of a box.
    """
    above = widget.parentWidget()
    while above is not None and not above.isWindow():
        if isinstance(
            above, QAbstractSpinBox | QComboBox | QLineEdit | QAbstractItemView | QTabBar
        ):
            return True
        above = above.parentWidget()
    return isinstance(widget, _PARTS) or (
        above is not None and above.inherits("QComboBoxPrivateContainer")
    )


def _name(widget) -> str:
    """What a screen reader says, as Qt works it out."""
    text = widget.text() if isinstance(widget, QAbstractButton) else ""
    buddies = (
        label.text() for label in widget.window().findChildren(QLabel) if label.buddy() is widget
    )
    return widget.accessibleName() or text or next(buddies, "")


def test_every_control_has_a_name(opened):
    controls = [
        w
        for w in _widgets()
        if isinstance(w, _CONTROLS) or w.focusPolicy() & Qt.FocusPolicy.TabFocus
    ]
    controls = [w for w in controls if not w.isWindow() and not _is_part(w)]
    assert len(controls) > 200
    unnamed = [w for w in controls if not _name(w) and not isinstance(w, QMenu | QMenuBar)]
    assert [
        f"{type(w).__name__} {w.objectName()!r} in {w.parentWidget().objectName()!r}"
        for w in unnamed
    ] == []


def test_no_letters_are_smaller_than_a_caption(opened):
    small = {
        (type(w).__name__, w.objectName()) for w in _widgets() if w.font().pointSizeF() < TEXT_PT
    }
    assert small == set()
    assert min(w.font().pointSizeF() for w in _widgets()) == TEXT_PT


def test_the_tab_key_reaches_every_button_of_the_tool_bar(opened):
    for name in ("tool_bar",):
        bar = opened.findChild(QToolBar, name)
        buttons = [b for b in bar.findChildren(QToolButton) if b.defaultAction() is not None]
        assert len(buttons) >= 4
        chain = {opened}
        widget = opened.nextInFocusChain()
        while widget not in chain:
            chain.add(widget)
            widget = widget.nextInFocusChain()
        for button in buttons:
            assert button.focusPolicy() & Qt.FocusPolicy.TabFocus, _name(button)
            assert button in chain, _name(button)


def test_qt_has_no_complaint_through_a_tour_of_the_window(open_window, touch_file, qtbot):
    said: list[str] = []
    before = qInstallMessageHandler(lambda _kind, _where, text: said.append(text))
    try:
        controller = open_window(touch_file, gl=True, target="gelslim", frame=2)
        window = controller.window
        assert wait_until_shown(controller, LIMIT_S), window.banner.text
        for name in (
            *(f"layout_{layout}" for layout in LAYOUT_NAMES),
            "theme_dark",
            "layout_look",
            "theme_light",
        ):
            window.actions_by_name[name].trigger()
            assert wait_until_shown(controller, LIMIT_S), (name, window.banner.text)
        for drawer in window.drawers:
            drawer.toggleViewAction().trigger()
        for size in ((1366, 768), (1600, 950)):
            window.resize(*size)
            qtbot.wait(50)
        for name in ("full_screen", "full_screen", *DIALOGS):
            window.actions_by_name[name].trigger()
            QApplication.processEvents()
        for top in QApplication.topLevelWidgets():
            if top is not window:
                top.close()
        assert wait_until_shown(controller, LIMIT_S), window.banner.text
    finally:
        qInstallMessageHandler(before)
    assert said == []
