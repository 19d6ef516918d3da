"""Histogram of the frames' metric: a drag lists the frames of a range."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from widgets.frames.frame_summary import FrameSummary
from widgets.frames.frames_panel import FramesPanel
from widgets.style.tables import get_limits, replace_limits

LIMITS = st.floats(-1e6, 1e6).filter(lambda value: abs(value) > 1e-6) | st.sampled_from(
    [math.inf, -math.inf, 0.0]
)


@given(st.lists(st.sampled_from(["contact", "slip", ">3", "<-0.5"]), max_size=4), LIMITS, LIMITS)
def test_limits_replace_those_of_the_filter_and_leave_its_words(words, low, high):
    text = replace_limits(" ".join(words), low, high)
    assert [word for word in text.split() if word[0] not in "<>"] == [
        w for w in words if w[0] not in "<>"
    ]
    for found, wanted, other in zip(
        get_limits(text), (low, high), (-math.inf, math.inf), strict=True
    ):
        assert (
            found == other
            if math.isinf(wanted)
            else abs(found - wanted) <= 0.006 * abs(wanted) + 1e-9
        )


def test_a_drag_lists_the_frames_of_a_range_and_a_click_all(qtbot):
    panel = FramesPanel()
    qtbot.addWidget(panel)
    panel.resize(400, 300)
    panel.show()
    panel.model.reset_frames(10)
    for frame in range(10):
        panel.model.show_summary(
            frame, FrameSummary(metrics={"a": float(frame)}, contact_area_mm2=3.0)
        )
    panel.offer_metrics({"a": "a: error, mm"}, "a", "error")
    histogram = panel.histogram
    qtbot.waitUntil(histogram.isVisible, timeout=10_000)
    assert sum(histogram.counts) == 10
    panel.filter_line.setText("contact")
    y = 10
    width = histogram.width()
    QTest.mousePress(histogram, Qt.MouseButton.LeftButton, pos=QPoint(width // 2, y))
    QTest.mouseMove(histogram, QPoint(width + 5, y))
    QTest.mouseRelease(histogram, Qt.MouseButton.LeftButton, pos=QPoint(width + 5, y))
    listed = sorted(panel._frame_of(row) for row in range(panel._sorted.rowCount()))
    assert listed == [5, 6, 7, 8, 9]
    assert panel.filter_line.text().startswith("contact >4.")
    QTest.mouseClick(histogram, Qt.MouseButton.LeftButton, pos=QPoint(width // 3, y))
    assert panel.filter_line.text() == "contact"
    assert panel._sorted.rowCount() == 10
