"""Sessions survive their file, and damaged files say where."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from PyQt6.QtGui import QUndoStack

from app.session.layout import ComparisonSettings, Layout
from app.session.state import Session, describe_removed_params, load_session, save_session
from app.session.undo import SessionChange
from pipeline.core.errors import FileProblem
from pipeline.core.params import replace_value
from pipeline.sensors.alignment import Offsets
from pipeline.views.display_params import DisplayParams


def a_session(folder: Path) -> Session:
    session = Session(
        recording=folder / "a.h5",
        target="gelslim",
        frame=7,
        mesh=folder / "m" / "ball.stl",
        cameras_linked=False,
        weights={"": folder / "own.safetensors", "touch": folder / "w" / "other.safetensors"},
        offsets=Offsets(
            translation_mm=(0.1, 0.0, -2.0), rotation_deg=(0.0, 3.0, 0.0), pivot_mm=(1.0, 2.0, 20.0)
        ),
    )
    display = replace_value(DisplayParams(), "gel_stretch", 5.0)
    other = Session(
        recording=folder / "b.h5", target="gelslim", frame=7, methods={"target_depth": "paper"}
    )
    session = session.with_updates(
        variant=other,
        comparison=ComparisonSettings(tab="two", order="in order", stage="target_depth"),
    )
    return session.with_updates(params={**session.params, "display": display})


def test_a_saved_session_loads_unchanged(tmp_path):
    session = a_session(tmp_path)
    save_session(session, tmp_path / "s.touch.json")
    assert load_session(tmp_path / "s.touch.json") == session


def test_cameras_are_saved_but_are_no_change(tmp_path):
    cameras = {"depth": tuple(float(n) for n in range(10))}
    session = replace(a_session(tmp_path), cameras=cameras)
    assert session == a_session(tmp_path)
    save_session(session, tmp_path / "s.touch.json")
    assert load_session(tmp_path / "s.touch.json").cameras == cameras


def test_what_an_older_session_says_of_pages_that_are_gone_is_ignored(tmp_path):
    path = tmp_path / "s.touch.json"
    save_session(a_session(tmp_path), path)
    data = json.loads(path.read_text())
    arrangement = {"name": "mine", "only_stage": "", "dock_state": "QQ==", "splitter_sizes_px": {}}
    data["layout"] |= {"name": "sweep", "arrangement": arrangement, "skipped_stages": ["pose"]}
    data["comparison"] |= {"tab": "seeds", "seeds": 4}
    path.write_text(json.dumps(data))
    session = load_session(path)
    assert (session.layout.name, session.comparison.tab) == ("compare", "grid")
    assert replace(
        session, layout=Layout(), comparison=a_session(tmp_path).comparison
    ) == a_session(tmp_path)


def test_a_setting_that_is_gone_costs_no_session_and_is_said_where_it_was_changed(tmp_path):
    path = tmp_path / "s.touch.json"
    save_session(a_session(tmp_path), path)
    data = json.loads(path.read_text())
    data["params"]["depth/physics"] = {"boundary": "flat", "sensitivity": 2.0}
    path.write_text(json.dumps(data))
    assert load_session(path).params["depth/physics"].sensitivity == 2.0
    assert describe_removed_params(path) == ()
    data["params"]["depth/physics"]["boundary"] = "free"
    path.write_text(json.dumps(data))
    assert load_session(path).params["depth/physics"].sensitivity == 2.0
    assert describe_removed_params(path) == (
        "depth/physics: boundary is no setting any more; the session opens without its 'free'",
    )


def test_paths_are_relative_to_the_session_file(tmp_path):
    old = tmp_path / "old"
    new = tmp_path / "new"
    old.mkdir()
    save_session(a_session(old), old / "s.touch.json")
    old.rename(new)
    assert load_session(new / "s.touch.json").recording == new / "a.h5"
    assert load_session(new / "s.touch.json").variant.recording == new / "b.h5"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"frame": "three"}, "frame"),
        ({"comparison": {"tab": "sideways"}}, "comparison"),
        ({"comparison": {"stage": 3}}, "comparison"),
        ({"cameras": {"depth": [1.0, 2.0]}}, "cameras"),
        ({"variant": {"tactoscope session": 3}}, "frame"),
        ({"frame": -1}, "frame"),
        ({"route": "sideways"}, "route"),
        ({"target": 4}, "target"),
        ({"params": {"display": {"gel_stretch": 1000.0}}}, "params.display.gel_stretch"),
        ({"params": {"unknown": {}}}, "params.unknown"),
        ({"offsets": {"translation_mm": [0, 0]}}, "offsets"),
        ({"weights": ["a.safetensors"]}, "weights"),
        ({"weights": {"depth": 3}}, "weights"),
    ],
)
def test_a_damaged_session_names_the_field(tmp_path, change, field):
    path = tmp_path / "s.touch.json"
    save_session(a_session(tmp_path), path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(FileProblem, match=field.split(".")[-1]):
        load_session(path)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"frame": 2**31}, "frame"),
        ({"frame": 10**400}, "frame"),
        ({"tick": 2**31}, "tick"),
        ({"notes": {str(2**31): "a"}}, "notes"),
        ({"params": {"depth/physics": {"contact_limit": 10**400}}}, "params"),
        ({"params": {"depth/physics": {"contact_limit": 2**60}}}, "params"),
    ],
)
def test_numbers_that_no_window_can_count_are_refused(tmp_path, change, field):
    path = tmp_path / "a.touch.json"
    save_session(Session(recording=tmp_path / "a.h5", target="digit"), path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(FileProblem, match=field):
        load_session(path)


def test_offsets_stay_only_with_the_alignment_they_were_made_from(tmp_path):
    session = a_session(tmp_path)
    assert session.with_updates(frame=3).offsets == session.offsets
    assert session.with_updates(recording=tmp_path / "b.h5").offsets.is_zero
    assert session.with_updates(target="digit").offsets.is_zero
    from_file = replace(session, alignment=tmp_path / "a.toml")
    assert from_file.with_updates(recording=tmp_path / "b.h5").offsets == session.offsets
    assert from_file.with_updates(alignment=None).offsets.is_zero


def test_a_file_that_is_no_session_is_refused(tmp_path):
    path = tmp_path / "s.touch.json"
    path.write_text("{}")
    with pytest.raises(FileProblem, match="not a session"):
        load_session(path)
    path.write_text("not json")
    with pytest.raises(FileProblem, match="JSON"):
        load_session(path)


def test_a_drag_is_one_undo_step(qapp):
    shown: list[Session] = []
    stack = QUndoStack()
    start = Session()
    session = start
    for frame in range(1, 50):
        new = replace(session, frame=frame)
        stack.push(SessionChange(old=session, new=new, text="go", key="frame", show=shown.append))
        session = new
    assert stack.count() == 1
    stack.undo()
    assert shown[-1] == start
    stack.redo()
    assert shown[-1].frame == 49


def test_changes_with_different_keys_do_not_merge(qapp):
    stack = QUndoStack()
    for key in ("frame", "params depth", ""):
        stack.push(
            SessionChange(
                old=Session(), new=Session(frame=1), text=key, key=key, show=lambda _s: None
            )
        )
    assert stack.count() == 3


def test_the_depth_unit_is_saved_and_an_unknown_one_is_refused(tmp_path):
    path = tmp_path / "s.touch.json"
    save_session(Session(target="gelslim", depth_unit="0.1mm"), path)
    assert load_session(path).depth_unit == "0.1mm"
    path.write_text(path.read_text().replace("0.1mm", "inch"))
    with pytest.raises(FileProblem, match="depth_unit: Invalid"):
        load_session(path)


@pytest.mark.parametrize("key", ["route", "depth_unit", "recording", "notes", "weights"])
def test_a_text_of_any_length_is_refused_in_a_short_sentence(tmp_path, key):
    path = tmp_path / "a.touch.json"
    save_session(Session(target="gelslim"), path, {})
    long = "x" * 100_000
    value = {"notes": {"1": long}, "weights": {long: "w"}}.get(key, long)
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(FileProblem, match=key) as caught:
        load_session(path)
    assert len(str(caught.value)) - len(str(path)) < 220
