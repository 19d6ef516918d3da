"""The palette of commands, and the copy of tables."""

from __future__ import annotations

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction, QGuiApplication
from PyQt6.QtWidgets import QTableWidget, QTableWidgetItem

from widgets.shell.command_palette import CommandPalette
from widgets.style.tables import TableCopier, format_table


def make_table(qtbot):
    table = QTableWidget(2, 3)
    qtbot.addWidget(table)
    table.setHorizontalHeaderLabels(["frame", "error, mm", "note"])
    for row, cells in enumerate((("3", "0.12", "a\tb"), ("7", "0.30", ""))):
        for column, text in enumerate(cells):
            table.setItem(row, column, QTableWidgetItem(text))
    return table


def test_a_command_is_found_by_name_key_and_description(qtbot):
    palette = CommandPalette(None)
    qtbot.addWidget(palette)
    commands = [QAction("&Open recording…"), QAction("Save session")]
    commands[0].setToolTip("Open a recording (Ctrl+O)")
    commands[1].setToolTip("Keep files, settings and layout (Ctrl+S)")

    def shown(text):
        palette.line.setText(text)
        return [palette.results.item(row).text() for row in range(palette.results.count())]

    palette.show_commands(commands)
    assert shown("") == ["Open recording…", "Save session"]
    assert shown("opn") == ["Open recording…"]
    assert shown("ctrl+s") == ["Save session"]
    assert shown("layout settings") == ["Save session"]
    assert shown("nothing of this") == []


def test_a_table_is_copied_with_titles_and_without_hidden_columns(qtbot):
    table = make_table(qtbot)
    assert format_table(table) == "frame\terror, mm\tnote\n3\t0.12\ta b\n7\t0.30\t\n"
    table.setColumnHidden(2, True)
    table.selectRow(1)
    assert format_table(table, only_selected=True) == "frame\terror, mm\n7\t0.30\n"


def test_ctrl_c_copies_the_table_that_has_the_focus(qtbot):
    table = make_table(qtbot)
    copier = TableCopier(table)
    copier.watch_tables(table)  # a table is no child of itself
    table.installEventFilter(copier)
    table.show()
    qtbot.keyClick(table, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    assert QGuiApplication.clipboard().text().startswith("frame\terror, mm")
