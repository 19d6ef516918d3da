"""What a file or its name puts into a line stays letters: no colour, no moved cursor, no second line."""

from __future__ import annotations

import shlex

import pytest

from pipeline.cli import hand_on
from pipeline.cli.terminal import complain, print_line

EVIL = "\x1b[31mred\x07\r\x9b2J \u202e [bold]bold[/bold] :smile: \udcff \x7f"


@pytest.mark.parametrize("say", [print_line, complain])
def test_a_line_is_shown_letter_by_letter(say, capfd):
    say(EVIL)
    said = "".join(capfd.readouterr())
    assert "\\x1b[31mred\\x07\\r\\x9b2J \\u202e [bold]bold[/bold] :smile: \\udcff \\x7f\n" in said
    assert not any(mark in said for mark in "\x1b\x07\r\x9b\u202e\x7f")


def test_the_command_that_plays_a_case_again_can_be_copied_whatever_its_folder_is_called(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(hand_on, "make_case", lambda *_, **__: None)
    folder = tmp_path / 'it\'s a "case"'
    hand_on.write_case(None, (), 3, folder, "")
    said = " ".join(capsys.readouterr().out.split("tactoscope ")[1:])
    assert shlex.split(said) == ["case", str(folder)]
