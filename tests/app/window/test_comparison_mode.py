"""Comparison modes: the truth instead of the result, their difference, wipe and blink."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPointF
from PyQt6.QtWidgets import QLabel

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown

LIMIT_S = 240


@pytest.fixture
def window(open_window):
    controller = open_window(
        SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5, route="t2d2"
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


def _choose(controller, versus):
    controller.window.actions_by_name[f"show_{versus}"].trigger()
    assert wait_until_shown(controller, LIMIT_S)


def _grey(image):
    return np.array(
        [
            [image.pixelColor(x, y).green() for x in range(image.width())]
            for y in range(28, image.height(), 4)  # under the words at the handle
        ],
        np.float64,
    )


def test_truth_mode_replaces_the_result_and_restores_it(window):
    views = {name: column.view for name, column in window.window.columns.items()}
    made = {name: view.preview for name, view in views.items()}
    _choose(window, "truth")
    truths = window.views.translation.read_true_outputs(5)
    assert set(truths) == {"depth", "target_depth", "touch", "touch_depth", "pose"}
    for name in truths:
        assert views[name].preview.caption.startswith("truth: "), name
    np.testing.assert_array_equal(views["depth"].preview.values, truths["depth"].indentation_mm)
    # of which no truth is known
    np.testing.assert_array_equal(views["cloud"].preview.pixels, made["cloud"].pixels)
    _choose(window, "truth")
    assert window.views.comparison_mode == ""
    np.testing.assert_array_equal(views["depth"].preview.pixels, made["depth"].pixels)


def test_the_difference_is_the_result_minus_the_truth(window):
    view = window.window.columns["touch_depth"].view
    made = view.preview.values.copy()
    _choose(window, "difference")
    true = window.views.translation.read_true_outputs(5)["touch_depth"].indentation_mm
    np.testing.assert_allclose(view.preview.values, made - true, atol=1e-6)
    assert view.preview.scale.low == -view.preview.scale.high
    pose = window.window.columns["pose"].view.preview
    assert pose.caption.startswith("distance to object")  # a signed distance has no difference


def test_one_comparison_mode_at_a_time(window):
    actions = window.window.actions_by_name
    _choose(window, "wipe")
    _choose(window, "difference")
    assert actions["show_difference"].isChecked()
    assert not actions["show_wipe"].isChecked()
    assert not window.window.columns["touch_depth"].view.overlay.is_visible


def test_the_truth_lies_right_of_the_wipe_handle(window):
    window.window.look.dims_chosen.emit(1, "both")
    _choose(window, "wipe")
    view = window.window.columns["touch_depth"].view
    overlay = view.overlay
    assert overlay.is_visible
    assert not window.window.columns["source"].view.overlay.is_visible
    seen = {}
    for share in (1.0, 0.0, 0.25):
        overlay.move_handle(share)
        seen[share] = view.canvas.grab().toImage()
    handle = round(view.canvas.to_screen(QPointF(0.25 * view.preview.pixels.shape[1], 0.0)).x())
    here, made, true = (_grey(seen[share]) for share in (0.25, 1.0, 0.0))
    for whose, other, part in (
        (made, true, slice(None, handle - 1)),
        (true, made, slice(handle + 2, None)),
    ):
        off, otherwise = (
            float(np.abs(here - picture)[:, part].mean()) for picture in (whose, other)
        )
        # a part is brought to size by itself, which moves a colour by a level or two
        assert off < 0.2 * otherwise
    overlay.move_handle(2.0)  # no farther than the picture
    assert overlay.share == 1.0
    assert not overlay.is_visible
    window.choose_frame(6)  # the handle stays where it was put
    assert wait_until_shown(window, LIMIT_S)
    assert overlay.share == 1.0


def test_blink_alternates_until_it_is_switched_off(window, qtbot):
    window.window.actions_by_name["stage_2"].trigger()
    _choose(window, "blink")
    overlay = window.window.columns["depth"].view.overlay
    seen = set()
    qtbot.waitUntil(
        lambda: (
            len(seen.union({overlay.is_visible}) and (seen.add(overlay.is_visible) or seen)) == 2
        ),
        timeout=240_000,
    )
    _choose(window, "blink")
    assert not overlay.is_visible
    assert not overlay.blink_timer.isActive()


def test_truth_is_not_computed_unless_requested(window, monkeypatch):
    translation = type(window.views.translation)
    asked = []
    honest = translation.read_true_outputs
    monkeypatch.setattr(
        translation,
        "read_true_outputs",
        lambda self, index, shown=None: asked.append((index, shown)) or honest(self, index, shown),
    )
    window.choose_frame(7)
    assert wait_until_shown(window, LIMIT_S)
    assert [stages for _, stages in asked if stages is not None] == [("touch",)]
    _choose(window, "truth")
    assert "depth" in next(stages for _, stages in reversed(asked) if stages is not None)


def test_a_recording_without_truth_shows_the_result(bubble_window):
    made = bubble_window.window.columns["depth"].view.preview
    _choose(bubble_window, "truth")
    shown = bubble_window.window.columns["depth"].view.preview
    assert shown.caption == made.caption
    np.testing.assert_array_equal(shown.pixels, made.pixels)
    texts = [label.text() for label in bubble_window.window.timeline.findChildren(QLabel)]
    assert [text for text in texts if text.startswith("round-trip error")], (
        "frames are ranked by what needs no truth"
    )
