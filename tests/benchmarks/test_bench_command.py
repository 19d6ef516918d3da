"""`tactoscope bench` over a folder of small benchmarks: what it prints, writes, and does when
one of them fails.
"""

from __future__ import annotations

import importlib
import json

import pytest

from benchmarks.harness import command, runner
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app

SOURCE = '''"""How fast is nothing? A second sentence."""
import math, os
from benchmarks.harness.timing import Requirement, Timing, build_measurement
from benchmarks.harness.results import BenchmarkResult
{needs}
def measure():
    print("not part of the report")
    t = Timing(median_ms=1.0, p95_ms=2.0)
    return BenchmarkResult(title="Nothing, with " + os.environ["OMP_NUM_THREADS"] + " threads", unit="um", rows=(
        build_measurement("{question}", ours=t, ours_error=0.1, unit="um", bar=Requirement(max_ms={ms}), peer="peer",
                          peer_timing=t),))
'''


def write(folder, name, needs="", ms=3.0):
    (folder / f"{name}.py").write_text(SOURCE.format(needs=needs, question=f"{name} asks", ms=ms))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    folder = tmp_path / "benchmarks"
    folder.mkdir()
    write(folder, "first")
    write(folder, "second", needs='NEEDS = "a display"')
    (folder / "no_benchmark.py").write_text('"""No result here."""\n')
    for function in (runner.list_benchmarks, runner.select_benchmarks):
        monkeypatch.setattr(command, function.__name__, lambda *a, f=function: f(*a, folder))
    return folder


def test_every_benchmark_that_needs_nothing_runs_and_its_rows_are_written(folder, tmp_path, capsys):
    out = tmp_path / "out" / "bench.json"
    code = run_app(build_app(), ["bench", "--json", str(out), "--plots", str(tmp_path / "plots")])
    printed = capsys.readouterr().out
    assert code == 0, printed
    report = json.loads(out.read_text())
    assert [row["question"] for row in report["rows"]] == ["first asks"]
    assert report["rows"][0]["peer_error"] is None
    assert report["rows"][0]["holds"] is True
    assert report["machine"]["threads"]["OMP_NUM_THREADS"] == "2"
    assert {"cpu", "cores", "python", "packages", "load"} <= set(report["machine"])
    assert report["questions"][0]["title"] == "Nothing, with 2 threads"
    assert "not part of the report" not in printed
    assert (tmp_path / "plots" / "first.png").exists()


@pytest.mark.parametrize("benchmark", runner.list_benchmarks(), ids=lambda known: known.name)
def test_a_benchmark_can_be_imported(benchmark):
    assert callable(importlib.import_module(f"benchmarks.{benchmark.name}").measure)


def test_a_benchmark_that_needs_more_runs_when_named(folder, capsys):
    assert run_app(build_app(), ["bench", "second"]) == 0
    assert "second asks" in capsys.readouterr().out


def test_the_list_says_what_each_needs(folder, capsys):
    assert run_app(build_app(), ["bench", "--list"]) == 0
    printed = capsys.readouterr().out
    assert "first" in printed
    assert "How fast is nothing?" in printed
    assert "by name only: needs a display" in printed
    assert "no_benchmark" not in printed


def test_a_failing_benchmark_is_one_line_and_the_others_run(folder, tmp_path, capsys):
    (folder / "broken.py").write_text("def measure():\n    import no_such_peer\n")
    out = tmp_path / "bench.json"
    assert run_app(build_app(), ["bench", "broken", "first", "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "no result: ModuleNotFoundError: No module named 'no_such_peer'" in printed
    assert "Traceback" not in printed
    report = json.loads(out.read_text())
    assert len(report["rows"]) == 1
    assert [bool(q["problem"]) for q in report["questions"]] == [True, False]


def test_a_killed_process_is_reported(folder, capsys):
    (folder / "dies.py").write_text("import os\ndef measure():\n    os.kill(os.getpid(), 9)\n")
    assert run_app(build_app(), ["bench", "dies"]) == 0
    assert "ended by SIGKILL" in capsys.readouterr().out


def test_a_benchmark_that_does_not_end_times_out(folder):
    (folder / "slow.py").write_text("import time\ndef measure():\n    time.sleep(60)\n")
    (benchmark,) = runner.select_benchmarks(("slow",), folder)
    assert runner.run_benchmark(benchmark, timeout_s=0.2).problem == "no result within 0.2 s"


def test_a_missed_bar_matters_to_strict_only(folder, capsys):
    write(folder, "missing_it", ms=0.5)
    assert run_app(build_app(), ["bench", "missing_it"]) == 0
    assert "1 missed: missing_it asks (at most 0.5 ms)" in capsys.readouterr().out
    assert run_app(build_app(), ["bench", "missing_it", "--strict"]) == 1
    assert run_app(build_app(), ["bench", "first", "--strict"]) == 0


def test_an_earlier_run_is_held_against_this_one(folder, tmp_path, capsys):
    out = tmp_path / "now.json"
    earlier = tmp_path / "earlier.json"
    assert run_app(build_app(), ["bench", "first", "--json", str(out)]) == 0
    assert run_app(build_app(), ["bench", "first", "--against", str(out), "--strict"]) == 0
    assert "none worse" in capsys.readouterr().out
    earlier.write_text(out.read_text().replace('"ours_error": 0.1', '"ours_error": 0.05'))
    assert run_app(build_app(), ["bench", "first", "--against", str(earlier)]) == 0
    assert (
        "1 worse\n  first: first asks against peer: error 0.05 -> 0.1 um" in capsys.readouterr().out
    )
    assert run_app(build_app(), ["bench", "first", "--against", str(earlier), "--strict"]) == 1
    assert (
        run_app(build_app(), ["bench", "first", "--against", str(tmp_path / "none.json")])
        == EXIT_USER_ERROR
    )


def test_an_unknown_benchmark_lists_the_known_ones(folder, capsys):
    assert run_app(build_app(), ["bench", "third"]) == EXIT_USER_ERROR
    assert "no benchmark 'third'; there are first, second" in capsys.readouterr().err


def test_where_the_folder_is_not_there_it_is_one_sentence(folder, tmp_path, capsys):
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    assert run_app(build_app(), ["bench"]) == EXIT_USER_ERROR
    assert "run bench there" in capsys.readouterr().err
