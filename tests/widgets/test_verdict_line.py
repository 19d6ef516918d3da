"""The verdict: a sentence that is never cut, its buttons, and the list of everything else."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel

from widgets.stages.verdict_line import Finding, VerdictLine


@pytest.fixture
def line(qtbot):
    line = VerdictLine()
    qtbot.addWidget(line)
    line.show()
    return line


FINDINGS = [
    Finding(sentence=f"Stage {n}: something is wrong with it: reason {n}", stage=f"stage_{n}")
    for n in range(6)
]


@pytest.mark.parametrize("wide", [420, 700, 1600])
def test_a_sentence_is_whole_at_every_width(line, qtbot, wide):
    cause = "84 % of it: the source saw only 66 % of the object."
    line.show_verdict("warning", "Frame 5 is 0.36 mm off.", cause, FINDINGS)
    line.resize(wide, line.heightForWidth(wide))
    label = line.findChild(QLabel)
    qtbot.waitUntil(lambda: label.height() >= label.heightForWidth(label.width()))
    assert line.sentence == f"Frame 5 is 0.36 mm off. {cause}"
    assert "more" not in line.list_button.text()


def test_every_finding_is_one_click_away_and_leads_to_its_stage(line, qtbot):
    line.show_verdict("warning", "Frame 5:", findings=FINDINGS)
    entries = line.list_button.menu().actions()
    assert [entry.text() for entry in entries] == [finding.sentence for finding in FINDINGS]
    with qtbot.waitSignal(line.finding_chosen) as chosen:
        entries[3].trigger()
    assert chosen.args == ["stage_3"]
    line.show_verdict("", "Frame 0 has no contact.")
    assert line.list_button.isHidden()


def test_buttons_act_and_a_sentence_is_no_markup(line, qtbot):
    done = []
    line.show_verdict("warning", "a < b & c", choices=[("Calibrate…", lambda: done.append(1))])
    qtbot.mouseClick(line.buttons[0], Qt.MouseButton.LeftButton)
    assert done == [1]
    assert "a &lt; b &amp; c" in line.findChild(QLabel).text()


def test_an_empty_verdict_takes_no_room(line):
    line.show_verdict("", "Frame 0 has no contact.")
    assert line.isVisible()
    line.show_verdict("", "")
    assert not line.isVisible()


def test_the_buttons_of_a_verdict_leave_with_it(line, qtbot):
    line.show_verdict("warning", "Frame 5 is 0.36 mm off.", choices=[("Show where", lambda: None)])
    (button,) = line.buttons
    qtbot.waitUntil(button.isVisible)
    line.show_verdict("", "Frame 6: no warning.")
    assert not button.isVisible()
