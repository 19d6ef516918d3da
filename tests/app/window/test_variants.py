"""Compare: two settings on one frame, and one touch by several seeds."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.compare.comparison import ComparisonController
from app.session.layout import DEFAULT_STAGE, ComparisonSettings
from app.session.sample import SAMPLE_RECORDING
from app.session.state import load_session
from app.shell.tour import wait_until_shown
from tests.app.window.command_runs import same_as_typed

LIMIT_S = 240
LIMIT_MS = 240_000


@pytest.fixture
def held(open_window, qtbot, touch_file):
    """The small recording, with its settings held."""
    instrument = open_window(touch_file, gl=True, target="gelslim", frame=2)
    assert wait_until_shown(instrument, LIMIT_S), instrument.window.banner.text
    comparing = next(
        child for child in instrument.children() if isinstance(child, ComparisonController)
    )
    instrument.window.actions_by_name["set_variant_settings"].trigger()
    _settle(qtbot, instrument, comparing)
    return instrument, comparing


def _settle(qtbot, instrument, comparing):
    def done() -> bool:
        tiles = _grid(instrument).tiles
        return (
            instrument.is_idle
            and not comparing.is_busy
            and not any(t.problem == "working…" for t in tiles)
        )

    qtbot.waitUntil(done, timeout=LIMIT_MS)
    qtbot.wait(20)
    qtbot.waitUntil(done, timeout=LIMIT_MS)


def _grid(instrument):
    return instrument.window.comparison.current_tab.grid


def _choose_stage(qtbot, instrument, comparing, name):
    box = instrument.window.comparison.stage_box
    box.setCurrentIndex(box.findData(name))
    box.activated.emit(box.currentIndex())
    _settle(qtbot, instrument, comparing)


def test_current_settings_are_compared_with_held_ones(held, qtbot):
    instrument, comparing = held
    assert instrument.session.layout.name == "compare"
    assert "no setting differs" in instrument.window.comparison.current_tab.message.text()
    method = instrument.catalogue.method("cloud", "back_projection")
    instrument.choose_params(method.key, replace(method.params(), stride=4))
    assert wait_until_shown(instrument, LIMIT_S)
    _choose_stage(qtbot, instrument, comparing, "target_depth")
    a, b, less = _grid(instrument).tiles
    assert (
        "Cloud, every n-th pixel: 4 | 1" in instrument.window.comparison.current_tab.message.text()
    )
    assert (a.title, b.title) == ("A · Target depth", "B · Target depth")
    assert less.difference is not None
    # the difference, without asking
    assert _grid(instrument).views[2].view.preview is less.difference
    for x_mm in (0.5, 1.0):
        instrument.change(
            "move the alignment",
            offsets=replace(instrument.session.offsets, translation_mm=(x_mm, 0.0, 0.0)),
        )
        _settle(qtbot, instrument, comparing)
    assert instrument.window.banner.isHidden(), instrument.window.banner.text
    _choose_stage(qtbot, instrument, comparing, "")
    tiles = _grid(instrument).tiles
    assert len(tiles) == 2 * len(instrument.window.columns)
    assert [t.starts_row for t in tiles].count(True) == 2


def test_the_copied_command_makes_the_same_pictures_and_figures(held, qtbot, tmp_path, monkeypatch):
    instrument, comparing = held
    instrument.choose_method("target_depth", "paper")
    assert wait_until_shown(instrument, LIMIT_S)
    _choose_stage(qtbot, instrument, comparing, "target_depth")
    same_as_typed(instrument, tmp_path, monkeypatch)
    # What was chosen is a step that can be undone, and the session keeps it.
    instrument.save_session(tmp_path / "a.touch.json")
    kept = load_session(tmp_path / "a.touch.json")
    assert kept.comparison == ComparisonSettings(tab="two", stage="target_depth")
    assert kept.variant.recording.resolve() == instrument.session.recording.resolve()
    instrument.undo_stack.undo()
    _settle(qtbot, instrument, comparing)
    assert instrument.window.comparison.stage_box.currentData() == DEFAULT_STAGE
    instrument.undo_stack.undo()
    instrument.undo_stack.undo()
    assert instrument.session.variant is None
    assert instrument.session.layout.name == "look"
    instrument.undo_stack.redo()
    assert instrument.session.variant is not None
    assert instrument.window.comparison.current_name == "two"


def test_cameras_of_the_3d_views_are_stored_in_the_session(held, qtbot, tmp_path):
    instrument, comparing = held
    scene = instrument.views.scene
    turned = (10.0, 20.0, -90.0, 0.0, 1.0, 20.0, 0.0, -1.0, 0.0, 30.0)
    scene.set_cameras({1: turned})
    instrument.save_session(tmp_path / "a.touch.json")
    instrument.window.actions_by_name["reset_view"].trigger()
    assert scene.get_cameras()[1] != pytest.approx(turned)
    instrument.open_session(tmp_path / "a.touch.json")
    _settle(qtbot, instrument, comparing)  # the comparison comes last
    assert scene.get_cameras()[1] == pytest.approx(turned)


def test_both_settings_follow_the_frame_and_b_can_be_removed(held, qtbot):
    instrument, comparing = held
    instrument.choose_frame(1)
    assert wait_until_shown(instrument, LIMIT_S)
    _settle(qtbot, instrument, comparing)
    assert "on frame 1" in instrument.window.comparison.current_tab.message.text()
    instrument.window.actions_by_name["clear_variant"].trigger()
    assert _grid(instrument).tiles == ()
    assert not instrument.window.actions_by_name["clear_variant"].isEnabled()


def test_a_problem_of_b_is_shown_in_its_place(held, qtbot, tmp_path):
    instrument, comparing = held
    comparing.set_variant_recording(tmp_path / "gone.h5")
    _settle(qtbot, instrument, comparing)
    tiles = _grid(instrument).tiles
    assert tiles[0].preview is not None
    assert "gone.h5" in tiles[1].problem
    comparing.set_variant_recording(SAMPLE_RECORDING)
    _settle(qtbot, instrument, comparing)
    assert (
        "recording: pressed.h5 | first_touch.h5"
        in instrument.window.comparison.current_tab.message.text()
    )
