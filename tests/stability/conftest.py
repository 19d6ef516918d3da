"""The size of the matrix (`--cases`), and its table at the end of a long run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.stability import rows

OUT = Path(__file__).resolve().parents[2] / "out" / "stability.json"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--cases",
        type=int,
        default=None,
        help="cases a row of tests/stability; left away: the short form",
    )


def pytest_configure(config: pytest.Config) -> None:
    asked = config.getoption("--cases", default=None)
    if asked is not None:
        rows.SIZE.cases, rows.SIZE.long = asked, asked > rows.SHORT


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    if config.getoption("--cases", default=None) is None:
        return
    terminalreporter.section("stability matrix")
    for line in rows.table():
        terminalreporter.line(line)
    rows.write(OUT)
