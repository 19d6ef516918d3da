"""Controls are derived from the parameter types."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from PyQt6.QtWidgets import (
    QAbstractSpinBox,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QLabel,
    QSlider,
    QSpinBox,
    QToolButton,
    QWidget,
)

from pipeline.core.params import list_settings, setting
from pipeline.translation.catalogue import BUILT_IN
from widgets.stages.parameters_panel import ParametersPanel


@dataclass(frozen=True, slots=True, kw_only=True)
class Some:
    """One of each kind."""

    depth_mm: float = setting(0.5, "Depth", unit="mm", low=0.0, high=2.0, step=0.1, help="how deep")
    open_mm: float = setting(1.0, "Open", unit="mm", low=0.0)
    count: int = setting(3, "Count", low=1, high=9)
    mode: str = setting("a", "Mode", choices=("a", "b"))
    keep: bool = setting(True, "Keep")


@pytest.fixture
def panel(qtbot):
    made = ParametersPanel()
    qtbot.addWidget(made)
    made.add_group("some", "Some stage", Some())
    made.show()
    return made


def test_every_kind_of_parameter_has_its_control(panel):
    assert panel.findChild(QComboBox, "some.mode").count() == 2
    assert panel.findChild(QCheckBox, "some.keep").isChecked()
    assert panel.findChild(QSpinBox, "some.count").value() == 3
    assert panel.findChild(QDoubleSpinBox) is not None


def test_labels_carry_units_and_tool_tips_the_help(panel):
    label = next(w for w in panel.findChildren(QLabel) if w.text() == "Depth, mm")
    assert "how deep" in label.toolTip()
    assert "depth_mm" not in label.toolTip(), "a name of the command line"


def test_editing_says_the_whole_new_value(panel, qtbot):
    with qtbot.waitSignal(panel.params_edited) as signal:
        panel.findChild(QComboBox, "some.mode").setCurrentText("b")
    assert signal.args == ["some", Some(mode="b")]


def test_slider_and_number_move_together(panel, qtbot):
    both = panel.findChild(QSlider).parentWidget()
    with qtbot.waitSignal(panel.params_edited) as signal:
        both.findChild(QSlider).setValue(400)
    assert signal.args[1].depth_mm == pytest.approx(2.0)
    assert both.findChild(QDoubleSpinBox).value() == pytest.approx(2.0)


def test_showing_values_says_nothing(panel, qtbot):
    with qtbot.assertNotEmitted(panel.params_edited):
        panel.show_params("some", Some(depth_mm=1.2, count=5, mode="b", keep=False))
    assert panel.findChild(QSpinBox, "some.count").value() == 5
    assert not panel.findChild(QCheckBox, "some.keep").isChecked()


def test_reset_brings_the_defaults_back(panel, qtbot):
    panel.show_params("some", Some(count=5))
    with qtbot.waitSignal(panel.params_edited) as signal:
        panel.findChild(QToolButton, "reset_some").click()
    assert signal.args[1] == Some()


def test_every_stage_of_the_pipeline_can_be_shown(qtbot):
    panel = ParametersPanel()
    qtbot.addWidget(panel)
    methods = BUILT_IN.methods("t2d2")
    for method in methods:
        panel.add_group(method.key, method.title, method.params())
    named = {control.objectName() for control in panel.findChildren(QWidget)}
    assert named >= {
        f"{method.key}.{name}" for method in methods for name in list_settings(method.params())
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Many:
    """A whole number of a wide range."""

    steps: int = setting(1, "Steps", low=0, high=1000)


def test_a_whole_number_of_a_wide_range_has_a_slider_with_the_most_room_for_small_ones(qtbot):
    panel = ParametersPanel()
    qtbot.addWidget(panel)
    panel.add_group("some", "Some", Many())
    slider = panel.findChild(QSlider)
    box = panel.findChild(QSpinBox)
    seen = []
    panel.params_edited.connect(lambda _key, params: seen.append(params.steps))
    slider.setValue(slider.maximum())
    slider.setValue(slider.maximum() // 5)
    assert seen == [1000, 8]
    assert box.value() == 8
    panel.show_params("some", Many(steps=1000))
    assert slider.value() == slider.maximum()
    assert seen == [1000, 8], "shown, not edited"


def test_a_held_slider_is_a_drag_until_it_is_let_go(panel, qtbot):
    slider = panel.findChild(QSlider)
    for change, held in ((slider.sliderPressed, "some"), (slider.sliderReleased, "")):
        with qtbot.waitSignal(panel.slider_held) as signal:
            change.emit()
        assert signal.args == [held]


def test_a_control_that_cannot_act_is_grey_and_says_why(panel):
    control = panel.findChild(QSpinBox, "some.count")
    tip = control.toolTip()
    panel.show_unavailable("some", {"count": "no network"})
    assert (control.isEnabled(), control.toolTip()) == (False, "no network")
    panel.show_unavailable("some", {})
    assert (control.isEnabled(), control.toolTip()) == (True, tip)


@dataclass(frozen=True, slots=True, kw_only=True)
class Picky:
    """One that says something of gels only."""

    any_mm: float = setting(0.5, "Any", unit="mm", low=0.0, high=2.0)
    gel_share: float = setting(0.5, "Of a gel", low=0.0, high=1.0, only="gel")


@pytest.mark.parametrize(("kind", "seen"), [("gel", True), ("bubble", False), ("", True)])
def test_what_says_nothing_of_the_sensor_on_screen_is_left_out(panel, kind, seen):
    panel.add_group("picky", "Picky", Picky())
    for shown in ("bubble", kind):
        panel.show_groups({"picky": shown})
    label = next(w for w in panel.findChildren(QLabel) if w.text() == "Of a gel")
    assert panel.findChild(QWidget, "picky.gel_share").isVisible() is seen
    assert label.isVisible() is seen
    assert panel.findChild(QWidget, "picky.any_mm").isVisible()


def test_no_value_is_cut_off_at_the_least_width_and_long_titles_wrap(qtbot):
    """The panel is never narrower than its values, and a title asks for no width."""
    panel = ParametersPanel()
    methods = [m for stage in BUILT_IN.stages for m in stage.methods]
    qtbot.addWidget(panel)
    for method in methods:
        panel.add_group(
            method.key,
            f"{method.title}, which has a very long name that no dock has room for",
            method.params(),
        )
    panel.show()
    for kind in ("gel", "bubble"):
        panel.show_groups({method.key: kind for method in methods})
        panel.resize(panel.minimumSizeHint().width(), 400)
        qtbot.waitUntil(lambda: panel.widget().width() <= panel.viewport().width())
        assert panel.width() < 330
        values = [w for w in panel.findChildren((QAbstractSpinBox, QComboBox)) if w.isVisible()]
        assert len(values) > 20
        cut = [
            w.objectName() or w.parentWidget().objectName()
            for w in values
            if w.width() < w.minimumSizeHint().width()
        ]
        assert cut == []
        titles = [
            w for w in panel.findChildren(QLabel) if "very long" in w.text() and w.isVisible()
        ]
        assert titles
        assert all(w.wordWrap() and w.height() >= w.heightForWidth(w.width()) for w in titles)
