"""How files know each other: imports, and what the table of features names."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]


def test_no_file_is_imported_by_what_it_imports():
    """Imports that only types need are left out, those inside functions count."""
    graph = grimp.build_graph(
        "pipeline", "app", "widgets", exclude_type_checking_imports=True, cache_dir=None
    )
    needs = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert sum(map(len, needs.values())) > len(needs)
    TopologicalSorter(needs).prepare()  # raises CycleError, which names the circle


def test_every_test_and_picture_of_the_features_exists():
    text = (ROOT / "docs" / "features.md").read_text()
    tables = [part.split("\n\n")[-1] for part in text.split("\n## ")[1:]]
    rows = [[line for line in table.splitlines()[2:] if line.startswith("|")] for table in tables]
    assert [len(table) for table in rows[:2]] == [48, 14]
    for row in (row for table in rows for row in table):
        tests = re.findall(r"`([\w/]+\.py)::(\w+)`", row)
        pictures = re.findall(r"`(tour/\w+\.png)`", row)
        assert tests or pictures or row.endswith("| no |"), row
        for file, name in tests:
            tree = ast.parse((ROOT / "tests" / file).read_text())
            assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, (
                file,
                name,
            )
        assert all((ROOT / "docs" / picture).is_file() for picture in pictures), row


def test_few_values_are_kept_outside_the_graph_and_the_cache_of_derived_values():
    """Caches that last as long as the process: decorated functions and memos of a module."""
    decorators = {"cache", "functools.cache", "lru_cache", "functools.lru_cache", "memoise"}
    found = []
    for package in ("pipeline", "app", "widgets"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.parse(path.read_text("utf-8")).body:
                if isinstance(node, ast.FunctionDef):
                    uses = [ast.unparse(d).partition("(")[0] for d in node.decorator_list]
                    found += [f"{path.stem}.{node.name}" for use in uses if use in decorators]
                elif (
                    isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation)[:5] == "Memo["
                ):
                    found.append(f"{path.stem}.{ast.unparse(node.target)}")
    assert 10 < len(found) <= 21, found
