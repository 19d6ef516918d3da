"""Notifications lie over the page, move nothing, stack and leave by themselves."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QRect
from PyQt6.QtWidgets import QLabel, QVBoxLayout, QWidget

from widgets.shell.banner import Banner
from widgets.style import notification_bar
from widgets.style.notification_bar import NotificationBar, NotificationStack


@pytest.fixture
def stacked(qtbot):
    over = QWidget()
    page = QLabel("page")
    below = QLabel("timeline")
    qtbot.addWidget(over)
    layout = QVBoxLayout(over)
    layout.addWidget(page, 1)
    layout.addWidget(below)
    stack = NotificationStack(over, page)
    bars = Banner(), NotificationBar("one"), NotificationBar("two")
    for bar in bars:
        stack.add_bar(bar)
    over.resize(800, 500)
    over.show()
    qtbot.waitExposed(over)
    yield page, stack, bars
    over.close()


@pytest.mark.parametrize("width", [800, 320])
def test_notifications_move_nothing_and_stack(stacked, qtbot, width):
    page, stack, (problem, one, two) = stacked
    page.window().resize(width, 500)
    qtbot.waitUntil(lambda: page.window().width() == width)
    assert stack.isHidden()
    before = page.geometry()
    problem.show_problem(
        "first_touch.h5, frame 3: the frame is cut short; choose another frame, or record it again"
    )
    one.show_notification("written: sheet.png", (("Show folder", lambda: None),))
    two.show_notification("copied")
    qtbot.waitUntil(lambda: stack.isVisible() and two.geometry().top() > one.geometry().bottom())
    assert page.geometry() == before
    places = [QRect(bar.geometry()) for bar in (problem, one, two)]
    assert not any(a.intersects(b) for i, a in enumerate(places) for b in places[i + 1 :])
    assert page.geometry().contains(stack.geometry())
    assert all(bar.height() >= bar.heightForWidth(bar.width()) for bar in (problem, one, two))
    one.hide()
    qtbot.waitUntil(lambda: two.geometry().top() < places[2].top())


def test_notifications_leave_by_themselves(stacked, qtbot, monkeypatch):
    _, stack, (problem, one, two) = stacked
    monkeypatch.setattr(notification_bar, "_ACT_MS", 40)
    problem._read_ms = one._read_ms = 20
    one.show_notification("copied")
    two.show_notification("written: sheet.png", (("Show folder", lambda: None),))
    problem.show_problem("sensor not known")
    qtbot.waitUntil(
        lambda: one.isHidden() and two.isHidden() and problem.isHidden() and stack.isHidden()
    )


def test_work_in_progress_and_open_details_stay(stacked, qtbot, monkeypatch):
    _, _, (problem, one, _) = stacked
    monkeypatch.setattr(notification_bar, "_ACT_MS", 10)
    problem._read_ms = 10
    one.show_notification("writing…", (("Cancel", lambda: None),), stays=True)
    problem.show_problem("out of memory", "Traceback")
    problem._more.setChecked(True)
    qtbot.wait(60)
    assert one.isVisible()
    assert problem.isVisible()
