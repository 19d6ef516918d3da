"""The pages: they build without a warning, their code runs, and what they name exists."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pytest

import tactoscope as ts
from pipeline.translation.catalogue import BUILT_IN

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"


def list_blocks(page):
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


def test_the_pages_build_and_no_link_leads_nowhere(tmp_path):
    pytest.importorskip("mkdocstrings_handlers.python")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    with warnings.catch_warnings():
        # of the libraries; those of the pages are logged, and end a strict build
        warnings.simplefilter("ignore")
        build(load_config(str(ROOT / "mkdocs.yml"), strict=True, site_dir=str(tmp_path)))
    api = (tmp_path / "api" / "index.html").read_text()
    assert all(
        f'id="{name}"' in api
        for name in ("tactoscope.open", "pipeline.core.values.results.DepthMap.indentation_mm")
    )


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_the_first_script_of_a_newcomer_runs(page, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    script = list_blocks(page)[0]
    assert len(script.splitlines()) <= 13
    for shown in ('frame.preview("touch").pixels', "frame.pose.alternatives"):
        assert shown in script
    exec(compile(script, page, "exec"), {})
    assert capsys.readouterr().out


def test_every_example_has_its_place_on_the_page():
    shown = re.findall(r'--8<-- "(.*?)"', (DOCS / "examples.md").read_text())
    assert sorted(shown) == sorted(
        str(path.relative_to(ROOT)) for path in (ROOT / "examples").glob("*.py")
    )


def test_figures_and_methods_of_the_choice_are_those_of_the_tables():
    page = (DOCS / "choosing.md").read_text()
    tables = (DOCS / "tables" / "README.md").read_text()
    cells = {cell.strip().partition(" [")[0] for cell in tables.replace("\n", "|").split("|")}
    rows = re.findall(r"`(\w+)` ([\d.]+), ([\d.]+)", page)
    assert len(rows) >= 20
    for method, error_mm, iou in rows:
        assert {error_mm, iou} <= cells
        BUILT_IN.method("touch", method)


def test_the_choice_says_what_the_sample_shows():
    page = (DOCS / "choosing.md").read_text()
    sample = ROOT / "sample_data/recordings/first_touch.h5"
    with ts.open(sample, "soft_bubble", source="gelslim") as touches:
        answers = touches.with_(method="t2t")[5].result("touch")
        assert not answers.fallback
        assert "pressed at this one" in " ".join(answers.notes)
        assert touches[5].result("touch").method.name == "object"
        counts = [
            len(touches.with_(method=name)[5].pose.alternatives) for name in ("t2t", "physics")
        ]
    assert counts == [1, 0]
    assert "frame.pose.alternatives" in page


def test_every_sentence_of_troubleshooting_is_one_that_the_program_says():
    sources = [ROOT / "tactoscope.py", *(ROOT / "pipeline").rglob("*.py")]
    code = re.sub(r'"\s*\n\s*f?"', "", "\n".join(path.read_text() for path in sources))
    rows = [
        line.split("|")[1]
        for line in (DOCS / "troubleshooting.md").read_text().splitlines()
        if line.startswith("| `")
    ]
    phrases = [phrase for row in rows for phrase in re.findall(r"`(.*?)`", row)]
    assert len(phrases) >= 18
    for phrase in phrases:
        words = re.escape(phrase).replace(r"\ 'left'", r"\ \{.*?\}")
        assert re.search(words, code), phrase
