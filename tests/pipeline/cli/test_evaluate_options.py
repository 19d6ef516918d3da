"""What `evaluate` refuses is refused before any touch is worked out."""

from __future__ import annotations

from pipeline.cli.main import build_app, run_app


def test_a_parameter_that_is_not_swept_is_told_at_once_and_nothing_is_written(tmp_path, monkeypatch, capsys):
    def worked_out(*_, **__):
        raise AssertionError("touches were worked out first")

    monkeypatch.setattr("pipeline.cli.evaluate.evaluated", worked_out)
    wanted = ["evaluate", "--split", "unseen_tools", "--sweep", "nonsense", "--json", str(tmp_path / "e.json")]
    assert run_app(build_app(), wanted) == 2
    assert "'nonsense' is not swept; there are steps, guidance" in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())
