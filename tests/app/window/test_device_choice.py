"""The device that networks run on: chosen in a menu, remembered, and not in session files."""

from __future__ import annotations

from app.main import show_window
from app.session.preferences import Preferences
from app.session.state import Session, load_session
from app.shell import device_choice
from app.shell.device_choice import DeviceController
from app.shell.tour import wait_until_shown

LIMIT_S = 60


def open_menu(controller, qtbot, monkeypatch, there):
    monkeypatch.setattr(device_choice, "list_devices", lambda: there)
    menu = controller.findChild(DeviceController).menu
    menu.aboutToShow.emit()
    qtbot.waitUntil(lambda: not menu.actions()[-1].text().startswith("looking"), timeout=60_000)
    return menu


def test_a_device_is_chosen_reaches_the_translation_and_is_remembered(
    bubble_window, qtbot, monkeypatch, tmp_path
):
    menu = open_menu(bubble_window, qtbot, monkeypatch, ("cpu",))
    assert [(a.text(), a.isEnabled()) for a in menu.actions()] == [
        ("auto", True),
        ("cpu", True),
        ("no graphics card found", False),
    ]
    menu.actions()[1].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.views.translation.request.device == "cpu"
    assert Preferences().device == "cpu"
    menu = open_menu(bubble_window, qtbot, monkeypatch, ("cpu", "cuda:0", "cuda"))
    assert [a.text() for a in menu.actions() if a.isEnabled()] == ["auto", "cpu", "cuda:0", "cuda"]
    assert [a.text() for a in menu.actions() if a.isChecked()] == ["cpu"]

    saved = tmp_path / "saved.touch.json"
    bubble_window.save_session(saved)
    assert "device" not in saved.read_text()
    assert load_session(saved).device == "auto"
    bubble_window.open_session(saved)
    assert bubble_window.session.device == "cpu"
    while bubble_window.undo_stack.canUndo():
        bubble_window.undo_stack.undo()
    assert Preferences().device == bubble_window.session.device == "auto"
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_a_device_that_is_not_there_is_one_sentence_and_mended_in_the_menu(
    touch_file, qtbot, monkeypatch, remembered_here
):
    Preferences().device = "toaster"
    controller = show_window(
        Session(recording=touch_file, target="gelslim", frame=0), with_scene=False, restore=True
    )
    qtbot.addWidget(controller.window, before_close_func=lambda _: controller.close())
    said = controller.window.banner
    qtbot.waitUntil(lambda: "toaster" in said.text, timeout=60_000)
    assert "no device 'toaster'; choose another: auto, cpu" in said.text
    open_menu(controller, qtbot, monkeypatch, ("cpu",)).actions()[0].trigger()
    assert wait_until_shown(controller, LIMIT_S)
    assert controller.views.translation.request.device == "auto"
    assert Preferences().device == "auto"
