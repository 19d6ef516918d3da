"""The alignment panel: handles, gauges and bars show what they are given and say what was done."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt

from pipeline.sensors.alignment import AXES
from pipeline.translation.alignment.score import AlignmentScore, ScoreChange, Sensitivity
from widgets.align.alignment_panel import AlignmentPanel

SCORE = AlignmentScore(
    iou=0.8, edge_px=3.0, depth_mm=0.05, depth_rms_mm=0.1, bias_mm=0.0, overlap_px=50
)


@pytest.fixture
def panel(qtbot) -> AlignmentPanel:
    made = AlignmentPanel()
    qtbot.addWidget(made)
    made.show_ready("gelslim", 0.5, 0.05)
    made.resize(made.minimumWidth(), 800)
    made.show()
    return made


def _signals(panel: AlignmentPanel) -> list[object]:
    heard: list[object] = []
    panel.drag_started.connect(lambda: heard.append("begun"))
    panel.offset_changed.connect(lambda axis, value: heard.append((axis, round(value, 6))))
    panel.drag_ended.connect(lambda: heard.append("ended"))
    return heard


def test_a_slider_is_one_drag_from_press_to_release(panel):
    heard = _signals(panel)
    slider = panel.rows["x"].slider
    slider.setSliderDown(True)
    slider.setValue(10)
    slider.setValue(20)
    slider.setSliderDown(False)
    assert heard == ["begun", ("x", 0.5), ("x", 1.0), "ended"]


def test_steps_of_a_box_are_one_change_that_ends_when_it_is_still(panel, qtbot):
    heard = _signals(panel)
    box = panel.rows["rz"].box
    box.stepUp()
    box.stepUp()
    assert heard == ["begun", ("rz", 0.1), ("rz", 0.2)]
    qtbot.waitUntil(lambda: heard[-1] == "ended", timeout=5_000)


@pytest.mark.parametrize("typed", ["2.5", "2,5"])
def test_a_decimal_comma_is_a_decimal_point(panel, qtbot, typed):
    box = panel.rows["x"].box
    box.selectAll()
    qtbot.keyClicks(box, typed)
    qtbot.keyClick(box, Qt.Key.Key_Return)
    assert box.value() == 2.5
    assert box.cleanText() == "2.500"


def test_shown_values_are_not_said_to_anybody(panel):
    heard = _signals(panel)
    panel.show_values((1.234, -2.0, 0.0, 0.25, 0.0, 20.0))
    assert panel.rows["x"].box.value() == 1.234
    assert panel.rows["rz"].box.value() == 20.0
    assert heard == []


def test_every_handle_says_what_it_moves_in_which_frame_and_unit(panel):
    for axis in AXES:
        row = panel.rows[axis]
        assert row.box.suffix().strip() in ("mm", "°")
        assert "gelslim frame" in row.box.toolTip()
        assert row.box.accessibleName() == row.slider.accessibleName() != ""
        assert ("centre of the contact" in row.box.toolTip()) == axis.startswith("r")


def test_gauges_keep_a_tick_where_the_drag_began(panel):
    panel.show_score(SCORE, "")
    panel.mark_ghosts(SCORE)
    panel.show_score(None, "there is nothing to compare with")
    assert panel.gauges["iou"].ghost == 0.8
    assert [g.text for g in panel.gauges.values()] == ["-", "-", "-"]
    assert panel.no_score_reason.text() == "there is nothing to compare with"


def test_gauges_have_units_and_survive_figures_beyond_their_limits(panel):
    panel.show_score(
        AlignmentScore(
            iou=1.0, edge_px=500.0, depth_mm=9.0, depth_rms_mm=None, bias_mm=None, overlap_px=1
        ),
        "",
    )
    assert [g.text for g in panel.gauges.values()] == ["1.000", "500.00 px", "9.000 mm"]
    panel.grab()


def test_bars_say_which_way_is_better(panel):
    def one(slope: float | None, size: float | None) -> ScoreChange:
        return ScoreChange(slope=slope, magnitude=size)

    axis = Sensitivity(
        axis="x",
        unit="mm",
        step=0.1,
        iou=one(-0.02, 0.02),
        edge_px=one(-0.5, 0.5),
        depth_mm=one(None, None),
    )
    panel.show_sensitivities((axis,))
    spoken = panel.bars.accessibleDescription()
    assert (
        spoken
        == "x: -, \N{BLACK UP-POINTING TRIANGLE} 0.50, \N{BLACK DOWN-POINTING TRIANGLE} 0.020"
    )
    panel.grab()


def test_nothing_can_be_moved_before_a_frame_is_judged(panel):
    panel.show_empty()
    assert not panel.rows["x"].box.isEnabled()


def test_the_panel_fits_its_least_width_without_cutting_anything_off(panel):
    body = panel.widget()
    assert body.width() >= body.minimumSizeHint().width()
    for row in panel.rows.values():
        assert row.box.width() >= row.box.minimumSizeHint().width()
