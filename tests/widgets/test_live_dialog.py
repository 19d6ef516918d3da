"""The dialog that names a live source."""

import pytest

from widgets.live.live_dialog import LiveDialog


@pytest.mark.parametrize(
    ("choice", "written", "words"),
    [
        ("simulated", "", ["simulated"]),
        ("folder", "a b", ["folder", "a b"]),
        ("address", "ws://robot:8765 /bubble/depth", ["ws://robot:8765", "/bubble/depth"]),
        ("address", "http://pi/?action=stream", ["http://pi/?action=stream"]),
        ("D20123", "", ["device", "D20123"]),
    ],
)
def test_what_is_chosen_is_named_as_on_the_command_line(qtbot, choice, written, words):
    dialog = LiveDialog()
    qtbot.addWidget(dialog)
    dialog.show_cameras([("D20123", "DIGIT D20123")])
    dialog.source.setCurrentIndex(dialog.source.findData(choice))
    dialog.folder.setText(written)
    dialog.partner.setText(" camera:1 ")
    with qtbot.waitSignal(dialog.watch_requested) as emitted:
        dialog.watch.click()
    assert emitted.args[0] == words
    assert emitted.args[2] == "camera:1"


def test_a_folder_or_address_must_be_written(qtbot):
    dialog = LiveDialog()
    qtbot.addWidget(dialog)
    dialog.show_cameras([])
    for choice in ("folder", "address"):
        dialog.source.setCurrentIndex(dialog.source.findData(choice))
        assert not dialog.watch.isEnabled()
        dialog.folder.setText("x")
        assert dialog.watch.isEnabled()
        dialog.folder.clear()
