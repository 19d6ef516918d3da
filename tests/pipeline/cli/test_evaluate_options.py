"""`evaluate` refuses wrong options before any touch is evaluated."""

from __future__ import annotations

from pipeline.cli.main import build_app, run_app


def test_an_unknown_sweep_parameter_is_refused_before_any_work(tmp_path, monkeypatch, capsys):
    def evaluate_touches(*_, **__):
        raise AssertionError("touches were evaluated first")

    monkeypatch.setattr("pipeline.cli.evaluate.evaluate_tables", evaluate_touches)
    words = [
        "evaluate",
        "--split",
        "unseen_tools",
        "--sweep",
        "nonsense",
        "--json",
        str(tmp_path / "e.json"),
    ]
    assert run_app(build_app(), words) == 2
    assert "'nonsense' cannot be swept; there are steps, guidance" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not list(tmp_path.iterdir())
