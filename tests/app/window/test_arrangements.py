"""Arrangements of one's own: kept, chosen, renamed, deleted, across starts and in sessions."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from app.session.layout import ARRANGEMENTS_FILE, Arrangement, Layout
from app.session.preferences import Preferences
from app.session.state import Session, load_session, save_session
from app.window import dialogs
from app.window.arrangements import ArrangementController
from app.window.dock_state import restore_arrangement
from app.window.tour import wait_until_shown
from pipeline.base.errors import FileProblem
from pipeline.base.typed_data import convert

LIMIT_S = 240


@pytest.fixture
def called(monkeypatch):
    """Answers the question for a name."""
    said = {"name": ""}
    monkeypatch.setattr(dialogs, "ask_name", lambda *_: said["name"])
    return said


def _file():
    return Preferences().settings_folder / ARRANGEMENTS_FILE


def test_an_arrangement_is_restored_as_saved(bubble_window, called, qtbot):
    controller, window, act = bubble_window, bubble_window.window, bubble_window.window.actions_by_name
    act["layout_inspect"].trigger()
    window.panes.dims_chosen.emit(0, "2D")
    window.drawers.frames.show()
    called["name"] = "mine"
    act["save_arrangement"].trigger()
    act["layout_stages"].trigger()
    window.drawers.frames.hide()
    assert controller.session.layout.arrangement is None
    chosen = next(a for a in window.actions() if a.text() == "Arrangement mine")
    assert chosen.shortcut().toString() == "Ctrl+Alt+1"
    chosen.trigger()
    assert controller.session.layout.name == "inspect"
    assert controller.session.layout.panes[0][1] == "2D"
    assert not window.drawers.frames.isHidden()
    assert chosen.isChecked()
    controller.undo_stack.undo()
    assert controller.session.layout.name == "stages"


def test_an_arrangement_includes_dragged_splitters(bubble_window, called, qtbot):
    window, rows = bubble_window.window, bubble_window.window.rows
    window.show()
    assert wait_until_shown(bubble_window, LIMIT_S)
    low = [rows.height() // 2 - 40, rows.height() // 2 + 40]
    rows.restore_sizes(low)
    qtbot.wait(50)
    kept = rows.sizes()
    called["name"] = "low"
    window.actions_by_name["save_arrangement"].trigger()
    rows.restore_sizes(())
    qtbot.waitUntil(lambda: abs(rows.sizes()[0] - kept[0]) > 10, timeout=240_000)
    window.actions_by_name["layout_stages"].trigger()
    next(a for a in window.actions() if a.text() == "Arrangement low").trigger()
    qtbot.waitUntil(lambda: abs(rows.sizes()[0] - kept[0]) < 4, timeout=240_000)


def test_arrangements_are_saved_renamed_and_deleted(open_window, called):
    first = open_window()
    for name in ("one", "two"):
        called["name"] = name
        first.window.actions_by_name["save_arrangement"].trigger()
    second = open_window()
    own, act = second.findChild(ArrangementController), second.window.actions_by_name
    assert [layout.arrangement.name for layout in own.arrangements] == ["one", "two"]
    assert not act["delete_arrangement"].isEnabled()
    own.apply_arrangement(own.arrangements[1])
    called["name"] = "three"
    act["rename_arrangement"].trigger()
    assert [layout.arrangement.name for layout in own.arrangements] == ["one", "three"]
    act["delete_arrangement"].trigger()
    assert [layout.arrangement.name for layout in open_window().findChild(ArrangementController).arrangements] == [
        "one"
    ]


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"tactoscope arrangements": 0}', '{"tactoscope arrangements": 1, "arrangements": [{"name": "moon"}]}',
     '{"tactoscope arrangements": 1}', '{"tactoscope arrangements": 1, "arrangements": [3]}'],
)  # fmt: skip
def test_an_unreadable_arrangements_file_is_reported_and_kept(open_window, called, text):
    _file().parent.mkdir(parents=True, exist_ok=True)
    _file().write_text(text)
    controller = open_window()
    assert "arrangements" in controller.window.banner.text
    called["name"] = "new"
    controller.window.actions_by_name["save_arrangement"].trigger()
    assert _file().with_name(ARRANGEMENTS_FILE + ".unread").read_text() == text
    assert len(json.loads(_file().read_text())["arrangements"]) == 1


def test_no_bytes_of_a_file_reach_qt(bubble_window, monkeypatch):
    window = bubble_window.window
    own = window.capture_arrangement("own")
    given = []
    monkeypatch.setattr(type(window), "restoreState", lambda _self, state, *_: given.append(bytes(state)) or True)
    damaged = own.dock_state[:-40] + "A" * 36 + own.dock_state[-4:]
    for state in (damaged, own.dock_state.partition(":")[2], "é:AAAA", ":", "x" * 1000):
        assert not restore_arrangement(window, replace(own, dock_state=state))
    assert given == []
    assert restore_arrangement(window, own)
    assert len(given) == 1


def test_drawers_of_another_version_are_reported(bubble_window):
    layout = Layout(arrangement=Arrangement("old", dock_state="AAAA"))
    bubble_window.findChild(ArrangementController).apply_arrangement(layout)
    assert "'old'" in bubble_window.window.banner.text


def test_a_session_stores_its_arrangement(tmp_path):
    layout = Layout(
        name="inspect",
        arrangement=Arrangement(
            "mine", only_stage="touch_depth", dock_state="QQ==", splitter_sizes_px={"split_rows": (300, 200)}
        ),
    )
    save_session(Session(layout=layout), tmp_path / "a.touch.json")
    assert load_session(tmp_path / "a.touch.json").layout == layout
    for wrong in ({"name": ""}, {"name": "a", "dock_state": 3}, {"name": "a", "splitter_sizes_px": {"x": ["y"]}}, 5):
        with pytest.raises(FileProblem, match=r"the layout cannot be used \(arrangement"):
            convert({"arrangement": wrong}, Layout, "the layout", tmp_path)
