"""The page of tables is what its script makes of the stored results; the plot of a task's
successes.
"""

import json
import runpy
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def test_the_page_of_tables_is_made_of_the_stored_results():
    tables = runpy.run_path(str(DOCS / "make_tables.py"))
    files = sorted((DOCS / "tables").glob("*.json"))
    page = tables["main"]([str(file) for file in files])
    assert (DOCS / "tables" / "README.md").read_text("utf-8") == f"{page}\n"
    rows = [line for line in page.splitlines() if "own sensor" in line and line.startswith("|")]
    assert rows
    assert all(".json)" in row for row in rows), "it says where a number is from"


def test_successes_are_drawn_over_each_disturbance(tmp_path, capsys):
    files = []
    for slip, tilt, outcomes in ((0.0, 0.0, (1, 1, 1)), (2.0, 0.0, (1, 0, 0)), (2.0, 3.0, (0, 0))):
        files.append(tmp_path / f"{slip} {tilt}.json")
        rollouts = [
            {"touch": touch, "tolerance_mm": 1.0, "succeeds": bool(one)}
            for touch in ("own", "t2t")
            for one in outcomes
        ]
        size = {"slip": slip, "tilt": tilt, "alignment": 0.0}
        files[-1].write_text(json.dumps({"disturbance": size, "rollouts": rollouts}))
    plot = runpy.run_path(str(DOCS / "make_disturbance_plot.py"))
    plot["main"](files, tmp_path / "plot.png", 1.0)
    said = capsys.readouterr().out
    assert "slip      own     0: 3/3 2: 1/3" in said
    assert "tilt      own     0: 3/3\n" in said, "two disturbances at once are in no panel"
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
