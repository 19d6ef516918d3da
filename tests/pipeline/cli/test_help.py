"""What `--help` tells: every command with its options, and what each of them is for."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from cyclopts import App

from pipeline.cli.main import build_app, run_app

WITHOUT_WORDS = re.compile(
    r"^│ \*?\s*(?:[A-Z]+ )?--[\w-]+(?: +[A-Z.]+)*\s+\[(?:default|required|choices)", re.MULTILINE
)


def commands(app: App, before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name in app:
        if not name.startswith("-"):
            if app[name].default_command is not None:
                yield *before, name
            yield from commands(app[name], (*before, name))


@pytest.mark.parametrize("words", list(commands(build_app())), ids=" ".join)
def test_every_option_says_what_it_is_for(words, capsys):
    assert run_app(build_app(), [*words, "--help"]) == 0
    said = capsys.readouterr().out
    assert f"tactoscope {' '.join(words)}" in " ".join(said.split())
    assert not WITHOUT_WORDS.findall(said)
