"""Sessions survive their file, and damaged files say where."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from PyQt6.QtGui import QUndoStack

from app.session.comparison_settings import ComparisonSettings
from app.session.state import Session, load_session, save_session
from app.session.undo import SessionChange
from pipeline.base.errors import FileProblem
from pipeline.base.params import replace_value
from pipeline.previews.display_params import DisplayParams
from pipeline.sensors.offsets import Offsets
from pipeline.translation.catalogue import BUILT_IN


def a_session(folder: Path) -> Session:
    session = Session(
        recording=folder / "a.h5", target="gelslim", frame=7, mesh=folder / "m" / "ball.stl", cameras_linked=False,
        weights={"": folder / "own.safetensors", "touch": folder / "w" / "other.safetensors"},
        offsets=Offsets(translation_mm=(0.1, 0.0, -2.0), rotation_deg=(0.0, 3.0, 0.0), pivot_mm=(1.0, 2.0, 20.0)),
    )  # fmt: skip
    display = replace_value(DisplayParams(), "gel_stretch", 5.0)
    other = Session(recording=folder / "b.h5", target="gelslim", frame=7, methods={"target_depth": "paper"})
    session = session.with_updates(
        held=other, comparison=ComparisonSettings(tab="two", order="in order", stage="target_depth", seeds=5)
    )
    return session.with_updates(params={**session.params, "display": display})


def test_a_session_comes_back_as_it_was_saved(tmp_path):
    session = a_session(tmp_path)
    save_session(session, tmp_path / "s.touch.json")
    assert load_session(tmp_path / "s.touch.json") == session


def test_where_the_3d_views_look_is_kept_but_is_no_change(tmp_path):
    looked = {"depth": tuple(float(n) for n in range(10))}
    session = replace(a_session(tmp_path), cameras=looked)
    assert session == a_session(tmp_path)
    save_session(session, tmp_path / "s.touch.json")
    assert load_session(tmp_path / "s.touch.json").cameras == looked


def test_paths_are_kept_relative_so_that_a_folder_can_be_moved(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    save_session(a_session(old), old / "s.touch.json")
    old.rename(new)
    assert load_session(new / "s.touch.json").recording == new / "a.h5"
    assert load_session(new / "s.touch.json").variant.recording == new / "b.h5"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"frame": "three"}, "frame"),
        ({"compared": {"tab": "sideways"}}, "compared"),
        ({"compared": {"seeds": "three"}}, "compared"),
        ({"cameras": {"depth": [1.0, 2.0]}}, "cameras"),
        ({"held": {"tactoscope session": 2}}, "source"),
        ({"frame": -1}, "frame"),
        ({"route": "sideways"}, "route"),
        ({"target": 4}, "target"),
        ({"params": {"display": {"gel_stretch": 1000.0}}}, "params.display.gel_stretch"),
        ({"params": {"unheard": {}}}, "params.unheard"),
        ({"offsets": {"shift_mm": [0, 0]}}, "offsets"),
        ({"weights": ["a.safetensors"]}, "weights"),
        ({"weights": {"depth": 3}}, "weights"),
    ],
)
def test_a_damaged_session_names_the_field(tmp_path, change, field):
    path = tmp_path / "s.touch.json"
    save_session(a_session(tmp_path), path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(FileProblem, match=field.split(".")[-1]) as caught:
        load_session(path)
    assert caught.value.field == field


def test_a_session_from_before_alignments_could_be_moved_still_opens(tmp_path):
    path = tmp_path / "s.touch.json"
    save_session(a_session(tmp_path), path)
    data = json.loads(path.read_text())
    del data["offsets"]
    path.write_text(json.dumps(data))
    assert load_session(path) == replace(a_session(tmp_path), offsets=Offsets())


def test_offsets_stay_only_with_the_alignment_they_were_made_from(tmp_path):
    session = a_session(tmp_path)
    assert session.with_updates(frame=3).offsets == session.offsets
    assert session.with_updates(recording=tmp_path / "b.h5").offsets.is_zero
    assert session.with_updates(target="digit").offsets.is_zero
    from_file = replace(session, alignment=tmp_path / "a.toml")
    assert from_file.with_updates(recording=tmp_path / "b.h5").offsets == session.offsets
    assert from_file.with_updates(alignment=None).offsets.is_zero


def test_a_file_that_is_no_session_says_so(tmp_path):
    path = tmp_path / "s.touch.json"
    path.write_text("{}")
    with pytest.raises(FileProblem, match="not a session"):
        load_session(path)
    path.write_text("not json")
    with pytest.raises(FileProblem, match="JSON"):
        load_session(path)


def test_a_drag_is_one_undo_step(qapp):
    shown: list[Session] = []
    stack, start = QUndoStack(), Session()
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


def test_changes_of_different_kinds_stay_apart(qapp):
    stack = QUndoStack()
    for key in ("frame", "params depth", ""):
        stack.push(SessionChange(old=Session(), new=Session(frame=1), text=key, key=key, show=lambda _s: None))
    assert stack.count() == 3


def test_a_session_of_before_is_read_with_what_has_become_a_method(tmp_path):
    path = tmp_path / "old.touch.json"
    words = {"source": "", "target": "gelslim", "stream": "", "route": "t2d2", "mesh_unit": "auto"}
    params = {
        "adapt": {"stride": 3},
        "project": {"mode": "paper", "jump_mm": 2.0},
        "pose": {"method": "surface", "seed": 4},
        "display": {"gel_stretch": 5.0},
    }
    path.write_text(json.dumps({"tactoscope session": 1, "frame": 2, "linked": True, **words, "params": params}))
    session = load_session(path)
    assert session.methods == {"target_depth": "paper"}
    given = {method.stage: session.get_params(method) for method in BUILT_IN.methods("t2d2")}
    assert (given["cloud"].stride, given["target_depth"].jump_mm, given["pose"].seed) == (3, 2.0, 4)
    assert session.display.gel_stretch == 5.0
    save_session(session, path)
    assert load_session(path) == session


def test_the_unit_of_depth_is_kept_and_an_unknown_one_is_named(tmp_path):
    path = tmp_path / "s.touch.json"
    save_session(Session(target="gelslim", depth_unit="0.1mm"), path)
    assert load_session(path).depth_unit == "0.1mm"
    path.write_text(path.read_text().replace("0.1mm", "inch"))
    with pytest.raises(FileProblem, match="depth_unit must be one of"):
        load_session(path)
