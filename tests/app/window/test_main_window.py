"""The window on a small recording: opens, fills its columns, plays, undoes, and survives bad
files.
"""

from __future__ import annotations

import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from PyQt6.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from PyQt6.QtGui import QDragEnterEvent, QDropEvent, QSurface
from PyQt6.QtWidgets import QFileDialog, QLabel

from app.session.sample import SAMPLE_RECORDING
from app.session.state import load_session
from app.shell.tour import run_tour, save_window_screenshot, wait_until_shown
from app.window.dialogs import OPEN_DIALOGS
from pipeline.core.errors import FileProblem
from pipeline.core.graph import Graph
from pipeline.core.params import replace_value
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.training.recipe import RECIPES_FOLDER
from pipeline.stages.cloud.back_projection import BackProjectionParams
from pipeline.stages.depth.photometric import DepthParams
from tests.app.conftest import bubble_frames
from widgets.frames.frames_model import CONTACT, DEPTH, METRIC
from widgets.style.theme import get_theme_colours

LIMIT_S = 240


def test_every_column_shows_content(bubble_window):
    window = bubble_window.window
    assert list(window.columns) == [
        "source",
        "depth",
        "cloud",
        "target_depth",
        "touch",
        "touch_depth",
        "pose",
    ]
    for name, column in window.columns.items():
        picture = column.view.preview
        assert picture is not None, name
        assert picture.frame_name.endswith("frame")
        assert picture.pixel_mm > 0
    assert {c.state for n, c in window.columns.items() if n != "pose"} <= {
        "read",
        "computed",
        "cached",
        "warning",
    }
    assert window.columns["depth"].view.preview.outline_px.size > 0


def test_a_skipped_column_shows_the_reason(bubble_window, qtbot):
    column = bubble_window.window.columns["pose"]
    assert column.state == "skipped"
    assert "mesh" in column.view.message.text()


def test_a_frame_without_contact_skips_and_a_repeated_frame_is_cached(bubble_window):
    bubble_window.choose_frame(0)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.results["touch"].state == "skipped"
    bubble_window.choose_frame(2)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.results["depth"].state == "cached"
    assert bubble_window.window.columns["depth"].state in ("cached", "warning")


def test_a_missing_file_is_reported_and_undone_to_the_recording_before(bubble_window, tmp_path):
    before = bubble_window.session
    bubble_window.open_path(tmp_path / "missing.h5")
    wait_until_shown(bubble_window, LIMIT_S)
    banner = bubble_window.window.banner
    assert banner.isVisible()
    assert "missing.h5" in banner.text
    assert "Traceback" not in banner.text + banner.details
    bubble_window.undo_stack.undo()
    assert not banner.isVisible()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session == before
    bubble_window.choose_frame(1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.index == 1


def test_a_file_that_is_no_recording_is_reported(open_window, tmp_path):
    bad = tmp_path / "bad.h5"
    bad.write_bytes(b"no recording at all")
    controller = open_window(bad)
    wait_until_shown(controller, LIMIT_S)
    assert controller.window.banner.isVisible()
    assert "bad.h5" in controller.window.banner.text
    assert controller.window.banner.details == ""


def test_a_bad_mesh_opened_while_the_frame_changes_is_undone(bubble_window, tmp_path):
    bad = tmp_path / "bad.stl"
    bad.write_text("no mesh at all")
    bubble_window.open_path(bad)
    bubble_window.choose_frame(1)
    wait_until_shown(bubble_window, LIMIT_S)
    assert "bad.stl" in bubble_window.window.banner.text
    assert bubble_window.session.mesh is None
    assert bubble_window.session.frame == 1
    bubble_window.window.banner.hide()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.index == 1
    bubble_window.choose_frame(2)
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_a_request_that_never_started_does_not_affect_the_next(bubble_window):
    go_on = threading.Event()
    bubble_window.job.submit(lambda _report: go_on.wait(LIMIT_S))
    try:
        bubble_window.choose_frame(0)
        bubble_window.choose_frame(1)
        assert "waiting" not in {column.state for column in bubble_window.window.columns.values()}
    finally:
        go_on.set()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.index == 1


def test_a_failing_stage_of_an_open_recording_undoes_nothing(bubble_window, tmp_path, monkeypatch):
    def fails(*_args, **_kwargs):
        raise RuntimeError("out of memory")

    bubble_window.choose_frame(1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    monkeypatch.setattr("pipeline.core.graph.Graph.evaluate", fails)
    bubble_window.open_path(tmp_path / "missing.stl")
    wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session.mesh is None
    assert bubble_window.session.frame == 1
    assert bubble_window.window.columns["depth"].state == "failed"


def test_a_mesh_can_be_closed_and_closes_with_its_recording(
    bubble_window, ball_file, touch_file, tmp_path
):
    close = bubble_window.window.actions_by_name["close_mesh"]
    assert not close.isEnabled()
    bubble_window.open_path(ball_file)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.results["pose"].state == "computed"
    close.trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.latest_frame.results["pose"].state == "skipped"
    bubble_window.undo_stack.undo()
    other = tmp_path / "other.h5"
    shutil.copy(touch_file, other)
    bubble_window.open_path(other)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session.mesh is None
    assert bubble_window.views.translation.mesh is None


def test_a_damaged_frame_after_two_route_changes_fails_alone(open_window, tmp_path):
    whole = SAMPLE_RECORDING.read_bytes()
    cut = tmp_path / "cut.h5"
    cut.write_bytes(whole[: len(whole) // 3])
    window = open_window(cut, target="gelslim", frame=0)
    wait_until_shown(window, LIMIT_S)
    held = threading.Event()
    window.job.submit(lambda report: held.wait(LIMIT_S))  # what is asked for meanwhile comes in one
    window.change("choose route", route="t2t")
    window.change("choose route", route="t2d2")
    window.choose_frame(15)
    held.set()
    wait_until_shown(window, LIMIT_S)
    assert window.session.frame == 15
    assert "damaged" in window.window.columns["source"].view.message.text()
    waits = {column.state for name, column in window.window.columns.items() if name != "source"}
    assert waits == {"waiting"}


def test_a_late_part_leaves_its_column_pending(bubble_window, monkeypatch):
    """The order is forced: a part of the frame before comes between the request for another one
    and its failure.
    """
    window = bubble_window
    over = threading.Event()
    part = window.views.get_shown_stage("source")
    error = FileProblem("this frame is damaged", SAMPLE_RECORDING)

    def fails(*_args, **_kwargs):
        over.wait(LIMIT_S)
        raise error

    monkeypatch.setattr(window.evaluator, "evaluate_frame", fails)
    window.choose_frame(1)
    before = window.requests.ticket
    window.choose_frame(0)
    window.handle_part(before, part)
    over.set()
    wait_until_shown(window, LIMIT_S)
    assert "this frame is damaged" in window.window.columns["source"].view.message.text()


def test_a_recording_that_fails_is_not_tried_again(bubble_window, tmp_path, qtbot, monkeypatch):
    empty = tmp_path / "empty.h5"
    empty.touch()

    def fails(*_args, **_kwargs):
        raise FileProblem("the file is empty", empty)

    monkeypatch.setattr(bubble_window.evaluator, "evaluate_frame", fails)
    bubble_window.change("open", recording=empty)
    wait_until_shown(bubble_window, LIMIT_S)
    qtbot.waitUntil(
        lambda: bubble_window.is_idle and not bubble_window.job.is_busy, timeout=240_000
    )
    before = bubble_window.job.newest_ticket
    qtbot.wait(300)
    assert bubble_window.job.newest_ticket == before
    assert "empty" in bubble_window.window.banner.text


def test_a_mesh_that_fails_after_an_undo_returns_to_the_earlier_session(bubble_window, tmp_path):
    """Another choice after an undo cuts what is open off the stack: nothing on it counts as
    open.
    """
    empty = tmp_path / "empty.obj"
    empty.touch()
    first = bubble_window.session.recording
    bubble_window.open_path(SAMPLE_RECORDING)
    assert wait_until_shown(bubble_window, LIMIT_S)
    bubble_window.undo_stack.undo()
    assert wait_until_shown(bubble_window, LIMIT_S)
    bubble_window.open_path(empty)
    wait_until_shown(bubble_window, LIMIT_S)
    assert "empty" in bubble_window.window.banner.text
    assert bubble_window.session.recording == first
    assert bubble_window.session.mesh is None
    assert bubble_window.views.translation.request.recording == first
    assert bubble_window.window.columns["depth"].state in (
        "computed",
        "cached",
        "unchanged",
        "warning",
    )


def test_undoing_a_mesh_computes_no_session_in_between(bubble_window, tmp_path):
    """Hours of steps lie under one failure, and none of them is worked out on the way.

    What failed is not tried twice.
    """
    empty = tmp_path / "empty.obj"
    empty.touch()
    bubble_window.open_path(empty)
    for k in range(12):
        bubble_window.change(f"note {k}", notes={0: str(k)})
    before = bubble_window.job.newest_ticket
    wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.job.newest_ticket <= before + 2
    assert "empty" in bubble_window.window.banner.text
    assert bubble_window.session.mesh is None


def test_a_translation_opened_for_a_dropped_request_is_delivered_to_the_next(
    open_window, touch_file
):
    """There and back and there again while it opens: what came of the first request is no answer
    to the last.
    """
    window = open_window(touch_file, target="gelslim", frame=2)
    assert wait_until_shown(window, LIMIT_S)
    window.change("choose route", route="t2t")
    limit_s = time.monotonic() + LIMIT_S
    while window.evaluator._translation.request.route != "t2t" and time.monotonic() < limit_s:
        time.sleep(0.001)  # the window's own thread hears of nothing meanwhile
    window.change("choose route", route="t2d2")
    window.change("choose route", route="t2t")
    assert wait_until_shown(window, LIMIT_S)
    assert window.window.visible_columns() == ("source", "touch", "touch_depth", "pose")
    states = {window.window.columns[name].state for name in ("touch", "touch_depth")}
    assert not states & {"stale", "running", "waiting", "failed"}


@pytest.mark.parametrize("layout", ["align", "look"])
def test_new_columns_of_a_route_are_filled(layout, open_window, touch_file):
    window = open_window(touch_file, target="gelslim", frame=2)
    window.change("choose route", route="t2t")
    assert wait_until_shown(window, LIMIT_S)
    window.change("lay out", layout=replace(window.session.layout, name=layout))
    # in Align it says, sooner or later, that this route has nothing to align
    wait_until_shown(window, LIMIT_S)
    window.change("choose route", route="t2d2")
    window.choose_frame(1)  # asked for before the route has text of its columns
    assert wait_until_shown(window, LIMIT_S)
    assert "target_depth" in window.window.visible_columns()
    assert window.window.columns["target_depth"].view.preview is not None
    states = {window.window.columns[name].state for name in window.window.visible_columns()}
    assert states <= {"read", "computed", "cached", "warning", "unchanged", "skipped"}


def test_weights_are_opened_closed_and_undone(bubble_window, tmp_path, caplog):
    close = bubble_window.window.actions_by_name["close_weights"]
    assert not close.isEnabled()
    file = tmp_path / "own.safetensors"
    file.write_bytes(b"whatever it holds")
    bubble_window.open_path(file)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session.weights == {"": file}
    result = bubble_window.latest_frame.results["depth"]  # the network's, which reads bubbles
    assert "truncated" in result.fallback
    assert (
        bubble_window.window.columns["depth"].findChild(QLabel, "note_depth").text() == result.badge
    )
    bubble_window.change("choose method", methods={"depth": "physics", "touch": "physics"})
    assert wait_until_shown(bubble_window, LIMIT_S)
    # no method of the route reads any now
    assert "the weights 'own.safetensors' count for nothing" in caplog.text
    close.trigger()
    assert bubble_window.session.weights == {}
    bubble_window.undo_stack.undo()
    assert bubble_window.session.weights == {"": file}
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_a_dropped_mesh_in_metres_names_the_remedy_in_the_window(bubble_window, tmp_path):
    corners = ((0, 0, 0), (0.02, 0, 0), (0, 0.02, 0), (0, 0, 0.02))
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces
    ]
    (tmp_path / "ball.obj").write_text("\n".join(lines) + "\n")
    bubble_window.open_paths([tmp_path / "ball.obj"])
    wait_until_shown(bubble_window, LIMIT_S)
    text = bubble_window.window.banner.text
    assert "Open mesh…" in text
    assert "Meshes in metres" in text
    assert "--mesh-unit" not in text
    assert bubble_window.session.mesh is None


def test_the_mesh_unit_is_chosen_on_opening_and_saved(
    bubble_window, ball_file, tmp_path, monkeypatch
):
    def in_metres(_parent, _title, _folder, kinds):
        return str(ball_file), next(kind for kind in kinds.split(";;") if "in metres" in kind)

    monkeypatch.setattr("PyQt6.QtWidgets.QFileDialog.getOpenFileName", in_metres)
    bubble_window.window.actions_by_name["open_mesh"].trigger()
    assert bubble_window.session.mesh == ball_file
    assert bubble_window.session.mesh_unit == "m"
    bubble_window.save_session(tmp_path / "s.touch.json")
    assert load_session(tmp_path / "s.touch.json").mesh_unit == "m"


def test_an_empty_recording_is_reported_over_empty_panes(bubble_window, tmp_path):
    empty = tmp_path / "empty.h5"
    with RecordingWriter(empty) as writer:
        writer.append("bubble", bubble_frames()[0])
    with h5py.File(empty, "r+") as file:
        for name, dataset in list(file["streams/bubble"].items()):
            if name != "references" and isinstance(dataset, h5py.Dataset):
                dataset.resize(0, axis=0)
    bubble_window.open_path(empty)
    wait_until_shown(bubble_window, LIMIT_S)
    assert "empty.h5" in bubble_window.window.banner.text
    assert [
        column.view.preview
        for column in bubble_window.window.columns.values()
        if column.view.preview
    ] == []
    assert bubble_window.window.columns["source"].state == "failed"


def test_an_unexpected_error_shows_a_sentence_and_a_traceback(bubble_window, monkeypatch):
    def fails(*_args, **_kwargs):
        raise RuntimeError("out of memory")

    monkeypatch.setattr("pipeline.core.graph.Graph.evaluate", fails)
    bubble_window.choose_frame(1)
    wait_until_shown(bubble_window, LIMIT_S)
    banner = bubble_window.window.banner
    assert "out of memory" in banner.text
    assert "\n" not in banner.text
    assert "Traceback" in banner.details
    assert bubble_window.window.columns["depth"].state == "failed"
    assert bubble_window.window.columns["depth"].view.preview is not None


def test_parameters_recompute_from_their_stage_on_and_can_be_undone(bubble_window):
    before = bubble_window.session
    params = replace_value(BackProjectionParams(), "stride", 2)
    bubble_window.choose_params("cloud/back_projection", params)
    assert wait_until_shown(bubble_window, LIMIT_S)
    results = bubble_window.latest_frame.results
    assert results["depth"].state == "cached"
    assert results["cloud"].state == "computed"
    bubble_window.undo_stack.undo()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session == before
    assert bubble_window.latest_frame.results["cloud"].state == "cached"


def _rows(controller) -> dict[int, tuple[str, ...]]:
    """What the table of frames says of those it knows."""
    model = controller.window.frames.model
    rows = {
        f: tuple(str(model.data(model.index(f, c))) for c in (METRIC, DEPTH, CONTACT))
        for f in range(model.rowCount())
    }
    return {f: cells for f, cells in rows.items() if any(cells)}


def test_the_frames_table_is_cleared_by_other_settings(bubble_window):
    bubble_window.choose_frame(1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    before = _rows(bubble_window)
    assert sorted(before) == [1, 2]
    bubble_window.choose_params(
        "display", replace_value(bubble_window.session.display, "gel_stretch", 5.0)
    )
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert _rows(bubble_window) == before
    bubble_window.choose_params("depth/physics", replace_value(DepthParams(), "contact_limit", 2.0))
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert sorted(_rows(bubble_window)) == [1]


def test_the_frame_error_is_that_of_the_generated_touch(open_window):
    """The sample knows the truth of its source.

    Of a sensor that took no part in it nothing is known.
    """
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="gelsight_mini", frame=6)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert "depth.contact_mae_mm" in controller.latest_frame.metrics
    assert "touch_depth.contact_mae_mm" not in controller.latest_frame.metrics
    labels = [label.text() for label in controller.window.timeline.findChildren(QLabel)]
    # ranks the frames in its place
    assert any(text.startswith("round-trip error") for text in labels)


def test_another_target_is_one_change(bubble_window):
    bubble_window.change("choose target", target="digit")
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.views.translation.target.name == "digit"
    rows, cols = bubble_window.window.columns["touch"].view.preview.pixels.shape[:2]
    assert (rows, cols) == bubble_window.views.translation.target.camera.shape


def test_hovering_a_pixel_marks_it_everywhere_and_reads_its_value(bubble_window):
    depth = bubble_window.latest_frame.results["depth"].output
    row, col = (int(i) for i in divmod(int(depth.indentation_mm.argmax()), depth.contact.shape[1]))
    bubble_window.probe.probe_pixel("depth", row, col)
    assert "mm in Soft Bubble frame" in bubble_window.window.readout.text()
    assert f"({col}, {row})" in bubble_window.window.readout.text()
    assert bubble_window.window.trace.text.startswith(f"({col}, {row})")
    assert " → " in bubble_window.window.trace.text
    assert bubble_window.window.columns["source"].view.canvas.crosshair == (row, col)
    assert bubble_window.window.columns["target_depth"].view.canvas.crosshair is not None
    bubble_window.probe.clear_trace()
    assert bubble_window.window.columns["source"].view.canvas.crosshair is None


def test_a_pinned_pixel_stays_while_the_mouse_moves_on(bubble_window):
    bubble_window.probe.toggle_pin("depth", 70, 86)
    bubble_window.probe.probe_pixel("depth", 10, 10)
    assert bubble_window.window.columns["depth"].view.canvas.crosshair == (70, 86)


def test_a_trace_belongs_to_the_frame_of_the_image(bubble_window, qtbot, monkeypatch):
    """While the touch is generated, what is above it is already the new frame's."""
    row = 70
    col = 86
    bubble_window.choose_frame(1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    bubble_window.probe.toggle_pin("depth", row, col)
    shallow = bubble_window.window.trace.text
    seen = threading.Event()
    go_on = threading.Event()

    evaluate = Graph.evaluate

    def stops_at_the_view(graph, wanted, inputs, params, progress, on_stage):
        def on(result):
            on_stage(result)
            if result.name == "target_depth":
                seen.set()
                go_on.wait(LIMIT_S)

        return evaluate(graph, wanted, inputs, params, progress, on)

    monkeypatch.setattr(Graph, "evaluate", stops_at_the_view)
    try:
        bubble_window.choose_frame(2)
        qtbot.waitUntil(seen.is_set, timeout=240_000)
        qtbot.wait(100)
        depth = bubble_window.window.columns["depth"].view.preview
        assert f"{depth.values[row, col]:.3f} mm" in bubble_window.window.trace.text
        assert "generated" in shallow
        assert "generated" not in bubble_window.window.trace.text
        bubble_window.probe.toggle_pin("touch", row, col)
        assert "not computed yet" in bubble_window.window.trace.findChild(QLabel).text()
    finally:
        go_on.set()
    wait_until_shown(bubble_window, LIMIT_S)


def drop(window, url):
    """Whether the window takes what is dragged over it; drops it there."""
    mime = QMimeData()
    mime.setUrls([url])
    how = (
        Qt.DropAction.CopyAction,
        mime,
        Qt.MouseButton.LeftButton,
        Qt.KeyboardModifier.NoModifier,
    )
    over = QDragEnterEvent(QPoint(5, 5), *how)
    over.ignore()  # as Qt sends it
    window.dragEnterEvent(over)
    window.dropEvent(QDropEvent(QPointF(5, 5), *how))
    return over.isAccepted()


def test_a_dropped_file_is_opened(open_window, touch_file):
    controller = open_window()
    assert not drop(controller.window, QUrl("https://example.org/touch.h5"))
    assert drop(controller.window, QUrl.fromLocalFile(str(touch_file)))
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.session.recording == touch_file


def test_a_dropped_sensor_description_is_the_source(open_window, tmp_path):
    controller = open_window()
    (tmp_path / "mine.toml").write_text('extends = "digit"\n')
    drop(controller.window, QUrl.fromLocalFile(str(tmp_path / "mine.toml")))
    assert (controller.session.source, controller.session.alignment) == (
        str(tmp_path / "mine.toml"),
        None,
    )


def test_a_dropped_recipe_is_named_and_changes_nothing(open_window):
    controller = open_window()
    before = controller.session
    drop(controller.window, QUrl.fromLocalFile(str(RECIPES_FOLDER / "bubble.toml")))
    assert "'tactoscope train'" in controller.window.banner.text
    assert controller.session == before


def test_a_session_file_restores_everything(bubble_window, open_window, tmp_path):
    path = tmp_path / "s.touch.json"
    bubble_window.save_session(path)
    other = open_window()
    other.open_path(path)
    assert wait_until_shown(other, LIMIT_S)
    assert other.session.frame == bubble_window.session.frame
    assert other.session.target == bubble_window.session.target


def test_playing_goes_on_to_the_last_frame_and_stops(bubble_window):
    seen: list[int] = []
    bubble_window.frame_shown.connect(seen.append)
    bubble_window.choose_frame(0)
    assert wait_until_shown(bubble_window, LIMIT_S)
    bubble_window.window.timeline.speed.setCurrentIndex(4)
    bubble_window.window.timeline.play(on=True)
    end_s = time.monotonic() + LIMIT_S
    while bubble_window.window.timeline.is_playing and time.monotonic() < end_s:
        wait_until_shown(bubble_window, 1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert seen[-1] == 2


def test_every_command_can_be_found_and_explains_itself(open_window):
    window = open_window().window
    for name, action in window.actions_by_name.items():
        assert action.objectName() == name
        assert action.text()
        assert action.toolTip()
    keys = [s.toString() for a in window.actions_by_name.values() for s in a.shortcuts()]
    assert len(keys) == len(set(keys))


@pytest.mark.gl
def test_the_tour_writes_screenshot_stages_and_report(open_window, touch_file, tmp_path):
    controller = open_window(touch_file, gl=True, target="gelslim")
    assert run_tour(controller, tmp_path / "out") == 0
    assert sorted(p.name for p in (tmp_path / "out").glob("frame_*")) == [
        "frame_0000",
        "frame_0001",
        "frame_0002",
    ]
    assert (tmp_path / "out" / "report.json").exists()
    assert (tmp_path / "out" / "window.png").stat().st_size > 20_000


@pytest.mark.gl
def test_the_window_is_not_rebuilt_when_3d_views_arrive(open_window, qtbot):
    """A window that takes up an OpenGL widget while it is shown goes black for that time."""
    controller = open_window(gl=True)
    handle = controller.window.windowHandle()
    number = int(controller.window.winId())
    qtbot.waitUntil(lambda: controller.views.scene.is_open, timeout=LIMIT_S * 1000)
    view = controller.window.views_3d[0]
    assert handle.surfaceType() == QSurface.SurfaceType.RasterSurface
    assert int(controller.window.winId()) == number
    assert (
        view.grab().toImage().pixelColor(5, 5).getRgb()[:3]
        == get_theme_colours(view.palette()).backdrop
    )


@pytest.mark.gl
def test_3d_views_are_in_the_screenshot(open_window, touch_file, tmp_path):
    controller = open_window(touch_file, gl=True, target="gelslim", frame=2)
    assert wait_until_shown(controller, LIMIT_S)
    save_window_screenshot(controller, tmp_path / "w.png")
    view = controller.window.view_panels["depth"].view
    corner = view.mapTo(controller.window, QPoint(0, 0))
    image = controller.window.grab().toImage()
    colours = {
        image.pixelColor(corner.x() + x, corner.y() + y).rgb()
        for x in range(4, view.width() - 4, 3)
        for y in range(4, view.height() - 4, 3)
    }
    assert len(colours) > 50  # a blank view has one


def test_opening_needs_no_gl(open_window, touch_file):
    controller = open_window(touch_file, target="gelslim", frame=1)
    assert wait_until_shown(controller, LIMIT_S)
    assert Path(controller.session.recording) == touch_file


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("folder", "source", "target"),
    [("gsmini_balls", "gelsight_mini", "soft_bubble"), ("digit_balls", "digit", "gelslim")],
)
def test_real_touches_go_through_all_columns(open_window, real_data, folder, source, target):
    controller = open_window(real_data / folder, source=source, target=target, frame=4)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert all(column.view.preview is not None for column in controller.window.columns.values())
    assert controller.latest_frame.results["depth"].output.contact.any()


def test_a_loop_begins_and_ends_at_the_chosen_frames(bubble_window):
    window = bubble_window.window
    for frame, command in ((1, "loop_from"), (2, "loop_to")):
        window.timeline.step_to(frame)
        window.actions_by_name[command].trigger()
    assert window.timeline.loop_range == (1, 2)
    assert window.actions_by_name["loop"].isChecked()
    window.actions_by_name["loop_all"].trigger()
    assert window.timeline.loop_range == (0, 2)
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_a_recording_of_an_unfit_sensor_is_shown_with_the_reason(open_window, touch_file):
    controller = open_window(touch_file, source="gelslim", target="soft_bubble", frame=1)
    assert not wait_until_shown(controller, LIMIT_S)
    assert "choose the right sensor" in controller.window.banner.text
    assert controller.window.columns["source"].view.preview is not None
    assert controller.window.columns["depth"].state == "failed"


def test_every_command_that_opens_a_file_asks_once(open_window, monkeypatch):
    window = open_window().window
    asked = []
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: asked.append("file") or ("", ""))
    monkeypatch.setattr(
        QFileDialog, "getExistingDirectory", lambda *_: asked.append("folder") or ""
    )
    for n_asked, command in enumerate(OPEN_DIALOGS, start=1):
        window.actions_by_name[command].trigger()
        assert len(asked) == n_asked, command
