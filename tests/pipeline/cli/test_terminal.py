"""Control characters in file names and contents are escaped in the terminal output."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from pipeline.cli import export
from pipeline.cli.terminal import print_error, print_line

SAMPLE = Path("touch.h5")
EVIL = "\x1b[31mred\x07\r\x9b2J \u202e [bold]bold[/bold] :smile: \udcff \x7f"


@pytest.mark.parametrize("say", [print_line, print_error])
def test_a_line_is_shown_letter_by_letter(say, capfd):
    say(EVIL)
    said = "".join(capfd.readouterr())
    assert "\\x1b[31mred\\x07\\r\\x9b2J \\u202e [bold]bold[/bold] :smile: \\udcff \\x7f\n" in said
    assert not any(mark in said for mark in "\x1b\x07\r\x9b\u202e\x7f")


def test_the_replay_command_can_be_copied_whatever_the_folder_is_called(
    monkeypatch, capsys, tmp_path
):
    monkeypatch.setattr(export, "write_bundle", lambda *_, **__: None)
    folder = tmp_path / 'it\'s a "bundle"'
    export.bundle(SAMPLE, target="gelslim", out=folder, frame=3)
    said = " ".join(capsys.readouterr().out.split("tactoscope ")[1:])
    assert shlex.split(said) == ["replay", str(folder)]
