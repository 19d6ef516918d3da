"""What undo, title and messages say."""

from __future__ import annotations

from dataclasses import replace

from PyQt6.QtGui import QGuiApplication

from app.compare.comparison import ComparisonController
from app.shell.tour import wait_until_shown
from pipeline.core.params import list_settings
from pipeline.lab.evaluation.comparison_tiles import Comparison


def test_undo_names_the_change_in_words(bubble_window):
    undo = bubble_window.window.actions_by_name["undo"]
    bubble_window.choose_frame(1)
    assert undo.text() == "Undo go to frame"
    method = next(method for method in bubble_window.methods if method.key.startswith("cloud"))
    params = bubble_window.session.get_params(method)
    bubble_window.choose_params(method.key, replace(params, stride=params.stride + 1))
    label = list_settings(params)["stride"][1].label.lower()
    assert (
        undo.text()
        == f"Undo change {label} of {bubble_window.catalogue.stage('cloud').title.lower()}"
    )
    assert wait_until_shown(bubble_window, 240)


def test_what_the_command_line_asks_for_is_no_change(open_window, touch_file):
    controller = open_window(
        touch_file, target="gelslim", frame=2, methods={"target_depth": "paper"}
    )
    assert wait_until_shown(controller, 240), controller.window.banner.text
    assert controller.session.methods == {"target_depth": "paper"}
    assert not controller.window.isWindowModified()
    controller.change("note on frame 2", notes={2: "deepest"})
    assert controller.window.isWindowModified()


def test_cancelling_twice_says_so_once(open_window):
    controller = open_window()
    comparison = controller.findChild(ComparisonController)
    message = controller.window.comparison.current_tab.message
    comparison.show_part(Comparison(tiles=(), summary="3 methods"))
    for _ in range(2):
        comparison.show_cancelled()
        assert message.text() == "cancelled; 3 methods"


def test_the_bell_holds_the_last_ten_messages_and_a_sentence_leaves(bubble_window, qtbot):
    window = bubble_window.window
    for number in range(12):
        window.say(f"message {number}")
    window.say("message 11")
    window.banner.show_problem("this went wrong")
    said = [sentence for _, sentence in window.bell.messages]
    assert said == [*(f"message {number}" for number in range(3, 12)), "This went wrong"]
    qtbot.waitUntil(lambda: not window.said, timeout=20_000)
    menu = window.bell.menu()
    menu.aboutToShow.emit()
    menu.actions()[0].trigger()
    assert QGuiApplication.clipboard().text() == "This went wrong"
