"""What does not open says what mends it.

A new recording clears the panes; every folder of real data opens.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PyQt6.QtWidgets import QLabel, QPushButton

from app.align.ball_calibration import calibrate
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.session.sample import SAMPLE_RECORDING
from app.shell.mending import MendingController
from app.shell.tour import wait_until_shown
from pipeline.io import open_recording
from pipeline.io.formats import list_formats
from pipeline.sensors.alignment import Offsets
from pipeline.sensors.spec import list_sensor_names, load_sensor
from widgets.shell.welcome import WelcomePage

LIMIT_S = 240


def find(buttons: list[QPushButton], words: str) -> QPushButton:
    return next(button for button in buttons if button.text().startswith(words))


def choose(button: QPushButton, words: str) -> None:
    """Two clicks: the button, and an entry of its menu."""
    next(action for action in button.menu().actions() if action.text().startswith(words)).trigger()


def count_images(controller: SessionController) -> int:
    return sum(column.view.preview is not None for column in controller.window.columns.values())


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Two recordings of a gel of unknown sensor, untouched at first."""
    rng = np.random.default_rng(0)
    for name in ("left", "right"):
        (tmp_path / "clips" / name).mkdir(parents=True)
        for i in range(4):
            image = rng.integers(90, 94, (68, 90, 3), np.uint8)
            assert cv2.imwrite(str(tmp_path / "clips" / name / f"touch_{i}.png"), image)
    return tmp_path / "clips"


def test_a_damaged_recording_clears_all_panes_and_offers_the_one_before(
    bubble_window, touch_file, tmp_path
):
    bad = tmp_path / "bad.npz"
    worse = tmp_path / "worse.h5"
    for path in (bad, worse):
        path.write_bytes(b"damaged")
    bubble_window.open_path(bad)
    assert count_images(bubble_window) == 0, "before the file is read"
    bubble_window.open_path(worse)
    wait_until_shown(bubble_window, LIMIT_S)
    banner = bubble_window.window.banner
    window = bubble_window.window
    assert count_images(bubble_window) == 0
    assert "worse.h5" in banner.text
    assert window.windowTitle().startswith("worse.h5")
    assert not window.timeline.isEnabled()
    assert [button.text() for button in banner.buttons] == [f"Return to {touch_file.name}"]
    banner.buttons[0].click()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert (bubble_window.session.recording, bubble_window.session.frame) == (touch_file, 2)
    assert count_images(bubble_window) == len(window.columns)


def test_a_damaged_recording_leaves_no_figures_of_the_one_before(open_window, qtbot, tmp_path):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    window = controller.window
    bars = window.error_attribution.waterfall
    qtbot.waitUntil(lambda: bool(bars.bars), timeout=LIMIT_S * 1000)
    bad = tmp_path / "bad.h5"
    bad.write_bytes(b"damaged")
    controller.open_path(bad)
    wait_until_shown(controller, LIMIT_S)
    assert not bars.bars
    assert not window.error_attribution.sentence.text()
    assert not any(one.share for one in window.look.filmstrip.thumbnails.values())
    assert not window.inspector._figures.rowCount()


def test_a_cancelled_opening_leaves_no_image_and_can_go_on(bubble_window, monkeypatch, qtbot):
    evaluate = bubble_window.evaluator.evaluate_frame

    def waits(session, stages, report, **how):
        while session.recording == SAMPLE_RECORDING and not report.cancelled.wait(0.01):
            pass
        return evaluate(session, stages, report, **how)

    monkeypatch.setattr(bubble_window.evaluator, "evaluate_frame", waits)
    bubble_window.open_path(SAMPLE_RECORDING)
    qtbot.waitUntil(lambda: bubble_window.job.is_busy, timeout=240_000)
    bubble_window.cancel()
    bar = bubble_window.findChild(MendingController).notification
    qtbot.waitUntil(lambda: "cancelled" in bar.text, timeout=240_000)
    assert count_images(bubble_window) == 0
    monkeypatch.undo()
    find(bar.buttons, "Open again").click()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.views.translation.request.recording == SAMPLE_RECORDING


def test_an_unknown_sensor_is_chosen_in_the_banner(open_window, clips):
    controller = open_window(clips / "right", target="soft_bubble")
    assert not wait_until_shown(controller, LIMIT_S)
    banner = controller.window.banner
    assert [b.text() for b in banner.buttons] == ["Choose sensor…"]
    choose(find(banner.buttons, "Choose sensor"), "GelSlim (markers)")
    assert wait_until_shown(controller, LIMIT_S), banner.text
    assert controller.views.translation.source.name == "gelslim"
    assert not banner.isVisible()


def test_a_source_that_was_chosen_first_counts(open_window, clips):
    controller = open_window(target="soft_bubble")
    controller.change("choose source", source="gelslim")
    controller.open_path(clips / "left")
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert controller.session.source == "gelslim"
    controller.open_path(SAMPLE_RECORDING)
    assert controller.session.source == "", "what is open had its own"
    assert wait_until_shown(controller, LIMIT_S)


def test_a_touch_beyond_the_target_is_centred_by_one_click(bubble_window):
    offsets = Offsets(translation_mm=(80.0, 0.0, 0.0))
    bubble_window.change("move alignment", offsets=offsets)
    assert wait_until_shown(bubble_window, LIMIT_S)
    view = bubble_window.latest_frame.results["target_depth"].output
    assert not view.contact.any()
    find(bubble_window.window.verdict.buttons, "Centre").click()
    assert wait_until_shown(bubble_window, LIMIT_S)
    view = bubble_window.latest_frame.results["target_depth"].output
    row, col = (float(index.mean()) for index in np.nonzero(view.contact))
    rows, cols = view.contact.shape
    assert abs(row - rows / 2) < 0.1 * rows
    assert abs(col - cols / 2) < 0.1 * cols
    bubble_window.undo_stack.undo()
    assert bubble_window.session.offsets == offsets


def test_a_calibration_needs_a_gel(bubble_window, tmp_path, qtbot):
    export = bubble_window.findChild(ExportController)
    calibrate(bubble_window, export, 6.35, tmp_path / "table.npz")
    qtbot.waitUntil(bubble_window.window.banner.isVisible, timeout=240_000)
    assert "the source is Soft Bubble" in bubble_window.window.banner.text
    assert not (tmp_path / "table.npz").exists()
    assert bubble_window.session.calibration is None


def test_a_recording_with_another_target_offers_it(open_window):
    controller = open_window(SAMPLE_RECORDING, target="gelslim_dotless", frame=11)
    assert wait_until_shown(controller, LIMIT_S)
    bar = controller.findChild(MendingController).notification
    find(bar.buttons, "Target Soft Bubble").click()
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.views.translation.target.name == "soft_bubble"
    assert bar.isHidden()


def test_formats_and_sensors_are_offered_by_their_names(open_window):
    window = open_window().window
    names = {load_sensor(name).title: name for name in list_sensor_names()}
    for box, first in ((window.source, 1), (window.target, 0)):
        assert {box.itemText(i): box.itemData(i) for i in range(first, box.count())} == names
    tip = window.findChild(WelcomePage).findChild(QLabel, "drop").toolTip()
    assert [f.title for f in list_formats() if f.title not in tip] == []


def test_the_target_of_a_recording_is_of_another_kind_than_its_source(open_window):
    controller = open_window(SAMPLE_RECORDING)
    assert wait_until_shown(controller, LIMIT_S)
    assert [s.sensor for s in open_recording(SAMPLE_RECORDING).streams] == [
        "gelslim",
        "digit",
        "soft_bubble",
    ]
    assert controller.session.target == "soft_bubble"


def _use_reference(controller: SessionController, real_data: Path) -> None:
    assert find(controller.window.banner.buttons, "Choose reference")
    # what the file dialog answers
    controller.open_reference(real_data / "gelslim3_balls" / "ref.jpg")


def _choose_sensor(controller: SessionController, _real_data: Path) -> None:
    choose(find(controller.window.banner.buttons, "Choose sensor"), "GelSlim (markers)")


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("folder", "mend", "n_frames"),
    [
        ("digit_balls", None, 42),
        ("gelslim3_balls", None, 39),
        ("gelslim3_objects", _use_reference, 10),
        ("gelslim4_clips", _choose_sensor, 43),
        ("gsmini_balls", None, 67),
        ("mini_things", None, 3),
        ("punyo_bubble", None, 33),
        ("t2t_pairs", None, 54),
    ],
)
def test_every_folder_of_real_data_opens_by_two_clicks(
    bubble_window, real_data, folder, mend, n_frames
):
    """After the file dialog: a button, and an entry of its menu or another dialog."""
    controller = bubble_window
    controller.open_path(real_data / folder)
    table = controller.window.folder
    if table.paths:  # it holds several, and Enter opens one
        table.recording_chosen.emit(table.paths[0])
    wait_until_shown(controller, LIMIT_S)
    if mend is not None:
        mend(controller, real_data)
        wait_until_shown(controller, LIMIT_S)
    assert not controller.window.banner.isVisible(), controller.window.banner.text
    assert controller.views.translation.n_frames == n_frames
    assert controller.latest_frame.results["depth"].output.contact.shape


@pytest.mark.real_data
def test_a_folder_of_meshes_opens_the_object_of_the_recording_before(
    bubble_window, real_data, touch_file
):
    bubble_window.open_path(real_data / "tools")
    wait_until_shown(bubble_window, LIMIT_S)
    banner = bubble_window.window.banner
    choose(find(banner.buttons, "Which of 34 meshes"), "hex_key.stl")
    wait_until_shown(bubble_window, LIMIT_S)
    find(banner.buttons, "Open in metres").click()
    assert wait_until_shown(bubble_window, LIMIT_S), banner.text
    assert bubble_window.session.recording == touch_file
    assert bubble_window.views.translation.mesh.vertices_mm.max() < 200.0


@pytest.mark.real_data
def test_a_folder_of_tables_says_what_it_is(bubble_window, real_data):
    page = bubble_window.window.folder
    bubble_window.open_path(real_data / "taxim_calibration")
    assert len(page.paths) > 1
    bubble_window.open_path(page.paths[0])
    assert not wait_until_shown(bubble_window, LIMIT_S)
    assert find(bubble_window.window.banner.buttons, "Return to")


def test_an_error_stands_in_place_of_the_verdict(bubble_window, tmp_path):
    window = bubble_window.window
    assert window.verdict.isVisible()
    mesh = tmp_path / "no_surface.obj"
    mesh.write_text("v 0 0 0\n")
    bubble_window.open_mesh(mesh)
    wait_until_shown(bubble_window, LIMIT_S)
    assert window.banner.isVisible()
    assert not window.verdict.isVisible(), "of the frame without that mesh"
    window.banner.hide()
    assert window.verdict.isVisible()
