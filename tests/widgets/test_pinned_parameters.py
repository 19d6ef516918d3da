"""Pinned parameters: one control for each range of a parameter, none made or destroyed while one
is in use.
"""

from __future__ import annotations

import gc
from dataclasses import dataclass

import pytest
from PyQt6.QtWidgets import QDoubleSpinBox, QLabel, QSlider, QSpinBox

from pipeline.core.params import setting
from widgets.stages.pinned_parameters import PinnedParameters


@dataclass(frozen=True)
class FewSteps:
    """Up to 50 steps."""

    steps: int = setting(4, label="Steps", low=1, high=50, pinned="Steps")


@dataclass(frozen=True)
class ManySteps:
    """Up to 1000 steps."""

    steps: int = setting(200, label="Steps", low=1, high=1000, pinned="Steps")


def test_a_step_that_changes_the_method_keeps_the_control_alive(qtbot):
    """The method changes within the control's own signal, and its control is hidden, not
    destroyed.
    """
    pinned = PinnedParameters()
    qtbot.addWidget(pinned)
    pinned.offer_methods([("touch/few", FewSteps()), ("touch/many", ManySteps())])
    pinned.show_params("touch/few", FewSteps(), {})
    pinned.show()
    edits: list[tuple[str, object]] = []

    def switch(key: str, params: object) -> None:
        edits.append((key, params))
        pinned.show_params("touch/many", ManySteps(steps=params.steps), {})
        gc.collect()

    pinned.params_edited.connect(switch)
    box = pinned.get_control("steps")
    assert isinstance(box, QSpinBox)
    box.stepBy(1)
    assert edits == [("touch/few", FewSteps(steps=5))]
    assert not box.isVisible()
    visible = [b for b in pinned.findChildren(QSpinBox) if b.isVisible()]
    assert [(b.maximum(), b.value()) for b in visible] == [(1000, 5)]
    box.stepBy(1)  # nothing is left dangling behind a hidden control
    gc.collect()
    pinned.show_params("touch/few", FewSteps(), {})
    assert pinned.get_control("steps") is box


@dataclass(frozen=True)
class UnpinnedSteps:
    """A number of the same name that its method does not pin."""

    steps: int = setting(7, label="Steps", low=1, high=9)


def test_a_parameter_that_only_another_method_pins_is_shown(qtbot):
    pinned = PinnedParameters()
    qtbot.addWidget(pinned)
    pinned.offer_methods([("touch/few", FewSteps()), ("touch/unpinned", UnpinnedSteps())])
    pinned.show_params("touch/unpinned", UnpinnedSteps(), {})
    assert pinned.get_control("steps").value() == 7


@dataclass(frozen=True)
class Three:
    """Three that stay in sight."""

    steps: int = setting(1, label="Steps", low=1, high=1000, pinned="Steps")
    guidance: float = setting(
        1.0, label="Guidance scale", unit="x", low=0.0, high=15.0, pinned="Guidance"
    )
    seed: int = setting(0, label="Seed", low=0, high=2**31 - 1, pinned="Seed")


@pytest.mark.parametrize("width_px", [247, 325, 600])
def test_one_line_shows_whole_numbers_and_sliders_where_they_fit(qtbot, width_px):
    pinned = PinnedParameters()
    qtbot.addWidget(pinned)
    pinned.offer_methods([("touch/three", Three())])
    pinned.set_wide(True)
    pinned.show_params("touch/three", Three(), {})
    pinned.setFixedWidth(width_px)  # as a column does
    pinned.show()
    box = next(box for box in pinned.findChildren(QDoubleSpinBox) if box.isVisible())
    qtbot.waitUntil(lambda: box.width() >= box.minimumSizeHint().width(), timeout=2000)
    assert box.text() == ("1.00" if width_px == 600 else "guidance 1.00")
    for kind in (QSlider, QLabel):
        assert any(widget.isVisible() for widget in pinned.findChildren(kind)) == (width_px == 600)
