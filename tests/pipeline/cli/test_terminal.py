"""What a file or its name puts into a line stays letters: no colour, no moved cursor, no second line."""

from __future__ import annotations

import shlex

import pytest

from pipeline.cli import export
from pipeline.cli.terminal import print_error, print_line

EVIL = "\x1b[31mred\x07\r\x9b2J \u202e [bold]bold[/bold] :smile: \udcff \x7f"


@pytest.mark.parametrize("say", [print_line, print_error])
def test_a_line_is_shown_letter_by_letter(say, capfd):
    say(EVIL)
    said = "".join(capfd.readouterr())
    assert "\\x1b[31mred\\x07\\r\\x9b2J \\u202e [bold]bold[/bold] :smile: \\udcff \\x7f\n" in said
    assert not any(mark in said for mark in "\x1b\x07\r\x9b\u202e\x7f")


def test_the_command_that_plays_a_case_again_can_be_copied_whatever_its_folder_is_called(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(export, "make_case", lambda *_, **__: None)
    folder = tmp_path / 'it\'s a "case"'
    export.run_bundle(None, (), 3, folder, "")
    said = " ".join(capsys.readouterr().out.split("tactoscope ")[1:])
    assert shlex.split(said) == ["case", str(folder)]
