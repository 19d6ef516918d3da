"""The README, the tour's text and the script that makes its pictures speak of the same ones."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from app.window.actions import MENUS, THEME_COMMANDS

DOCS = Path(__file__).resolve().parents[1] / "docs"


def test_every_picture_of_the_tour_is_made_by_its_script_and_there():
    shown = set(re.findall(r"\(tour/(\w+)\.png\)", (DOCS / "tour.md").read_text()))
    shown |= set(re.findall(r"\(docs/tour/(\w+)\.png\)", (DOCS.parent / "README.md").read_text()))
    tree = ast.parse((DOCS / "make_tour.py").read_text())
    table = next(
        n.value
        for n in tree.body
        if isinstance(n, ast.Assign) and getattr(n.targets[0], "id", "") == "PICTURES"
    )
    assert shown == {key.value for key in table.keys}
    assert all((DOCS / "tour" / f"{name}.png").stat().st_size > 20_000 for name in shown)


@pytest.mark.parametrize("page", ["tour.md", "features.md"])
def test_commands_that_a_page_names_are_in_the_menu(page):
    text = (DOCS / page).read_text()
    titles = {
        menu.replace("&", ""): {command.text for command in commands}
        for menu, commands in MENUS.items()
    }
    titles["View"] |= {command.text for command in THEME_COMMANDS}
    named = re.findall(r"\*(\w+) > ([^*]+)\*", text)
    assert named
    for menu, command in named:
        assert command in titles[menu], (menu, command)
