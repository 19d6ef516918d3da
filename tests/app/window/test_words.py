"""No label, tooltip or choice of the window shows a name that only the code or the command line
knows.
"""

from __future__ import annotations

import re

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QComboBox, QPlainTextEdit, QTabBar, QTableView, QWidget

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.core.errors import name_options
from pipeline.sensors.spec import list_sensor_names
from pipeline.translation.catalogue import BUILT_IN

# a name with an underscore, a parameter of a stage, an option of the command line
_STAGES = "|".join(stage.name for stage in BUILT_IN.stages)
INTERNAL = re.compile(rf"[a-z]\w*_[a-z]\w*|\b({_STAGES}|display)\.[a-z]|(?<![\w-])--[a-z]")
# as the plain names of files, commands and people read them
ALLOWED = re.compile(
    rf"{re.escape(str(SAMPLE_RECORDING))}|{re.escape(SAMPLE_RECORDING.name)}|gelslim_depth"
)


def list_texts(window: QWidget) -> set[str]:
    """List every text that a widget of the window shows, or would show."""
    texts = [action.text() for action in window.actions()]
    texts += [action.toolTip() for action in window.actions()]
    tip = Qt.ItemDataRole.ToolTipRole
    for widget in window.findChildren(QWidget):
        if isinstance(widget, QPlainTextEdit):  # the log
            continue
        for name in ("text", "toolTip", "placeholderText", "title"):
            read = getattr(widget, name, None)
            texts += [str(read())] if callable(read) else []
        if isinstance(widget, QComboBox):
            items = range(widget.count())
            texts += [widget.itemText(i) for i in items]
            texts += [str(widget.itemData(i, tip) or "") for i in items]
        if isinstance(widget, QTabBar):
            texts += [widget.tabText(i) for i in range(widget.count())]
        if isinstance(widget, QTableView) and (model := widget.model()) is not None:
            for column in range(model.columnCount()):
                for role in (Qt.ItemDataRole.DisplayRole, tip):
                    texts.append(
                        str(model.headerData(column, Qt.Orientation.Horizontal, role) or "")
                    )
                    texts += [
                        str(model.index(row, column).data(role) or "")
                        for row in range(model.rowCount())
                    ]
    return {line for text in texts for line in text.splitlines() if line.strip()}


def find_internal(texts: set[str]) -> list[str]:
    """List the texts that show an internal name."""
    return sorted(text for text in texts if INTERNAL.search(ALLOWED.sub("", text)))


def test_no_text_of_the_window_shows_an_internal_name(open_window, qtbot):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, 240), controller.window.banner.text
    texts = list_texts(controller.window)
    page = controller.window.comparison
    for command in ("layout_align", "set_variant_settings", "layout_task", "layout_folder"):
        controller.window.actions_by_name[command].trigger()
        assert wait_until_shown(controller, 240)
        if command == "layout_align":
            qtbot.waitUntil(controller.window.alignment.gauges["iou"].isVisible, timeout=240_000)
        if command == "set_variant_settings":
            qtbot.waitUntil(lambda: len(page.variants.grid.tiles) == 3, timeout=240_000)
        texts |= list_texts(controller.window)
    assert len(texts) > 500
    assert find_internal(texts) == []


@pytest.mark.parametrize(
    ("sentence", "said"),
    [
        ("choose one (--sensor): 'a.h5'", "choose one: 'a.h5'"),
        ("choose its image (reference=, --reference)", "choose its image"),
        (
            "name one with --reference, or give --depth-unit mm",
            "name one with the reference, or give the depth unit mm",
        ),
        ("a -- b, -5 mm, co--op", "a -- b, -5 mm, co--op"),
    ],
)
def test_options_of_the_command_line_are_said_in_words(sentence, said):
    assert name_options(sentence) == said
    assert find_internal({name_options(sentence)}) == []


def test_internal_names_are_found():
    for text in ("soft_bubble frame", "touch.guidance", "choose one (--sensor)", "contact_mae_mm"):
        assert find_internal({text}) == [text]
    assert find_internal({"DPM-Solver++ (2M)", "0.3 mm", "S -> T", "co-planar"}) == []
    assert any("_" in name for name in list_sensor_names())
