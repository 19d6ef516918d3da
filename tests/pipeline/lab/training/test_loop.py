"""Training loop: the same weights however a run is stopped, whichever process makes its examples.

Failures are reported.
"""

from __future__ import annotations

import csv
import itertools
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.core.errors import FileProblem, NotConverged, SettingProblem
from pipeline.core.progress import Cancelled
from pipeline.lab.training import examples, loop
from pipeline.lab.training import run_folder as state
from pipeline.lab.training.loop import TrainingRun, train
from pipeline.lab.training.recipe import load_recipe, override_training
from pipeline.lab.training.run_folder import make_weights
from pipeline.stages.networks.weights import save_weights
from tests.pipeline.lab.training import toy

ROOT = Path(__file__).parents[4]
LONG_S = 280  # far more than needed on a busy machine
PROGRAM = """
import sys
from pipeline.cli.main import build_app, run_app
from pipeline.lab.training import loop
from tests.pipeline.lab.training import toy
if __name__ == "__main__":
    toy.register()
    loop.SAVE_INTERVAL_S = 0.0
    sys.exit(run_app(build_app(), ["train", "discs", *sys.argv[1:]]))
"""


class StopAt:
    def __init__(self, step):
        self.left = step

    def step(self, fraction, text):
        self.left -= 1
        if self.left < 0:
            raise Cancelled


@pytest.fixture
def run(recipe_file, tmp_path):
    return TrainingRun(
        recipe=load_recipe(str(recipe_file), "discs"), folder=tmp_path / "run", n_workers=0
    )


def tensors(run_state):
    return make_weights(run_state, "x").tensors


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a) and a.keys() == b.keys()


def rows(folder, name):
    with (folder / name).open() as file:
        return [{k: v for k, v in row.items() if k != "minutes"} for row in csv.DictReader(file)]


def test_a_stopped_run_ends_with_the_weights_and_curves_of_an_uninterrupted_one(run, tmp_path):
    whole = train(replace(run, folder=tmp_path / "whole"))
    for stop in (7, 30):
        with pytest.raises(Cancelled):
            train(replace(run, resume=True), StopAt(stop))
    stopped = train(replace(run, resume=True))
    assert stopped.step == whole.step == 60
    assert stopped.n_examples == whole.n_examples == 240
    assert same(tensors(stopped), tensors(whole))
    for name in ("curve.csv", "figures.csv"):
        assert rows(run.folder, name) == rows(tmp_path / "whole", name)
        assert rows(run.folder, name)


@pytest.mark.parametrize("n_cached", [0, 8])
def test_a_run_stops_while_examples_are_made(run, n_cached):
    """An example takes five minutes; stopping takes as long as a worker process needs to start."""
    recipe = override_training(
        replace(run.recipe, settings=toy.SlowDiscs()), n_cached_examples=n_cached
    )
    with pytest.raises(Cancelled):
        train(replace(run, recipe=recipe, n_workers=1), StopAt(2))
    assert state.load_for_resume(run.folder, recipe).trained_s < 120.0


def test_the_network_learns_and_its_average_is_evaluated(run):
    done = train(run)
    first = done.metrics[0]["value"]
    last = done.metrics[-1]["value"]
    assert last > max(0.8, first)
    assert done.curve[-1]["loss"] < 0.5 * done.curve[0]["loss"]
    assert (run.folder / "curve.png").stat().st_size > 1000
    assert not same(tensors(done), {name: t.numpy() for name, t in done.network_tensors.items()})


def test_another_seed_gives_other_weights_and_the_same_seed_the_same(run, tmp_path):
    short = override_training(run.recipe, steps=4)
    made = [
        tensors(
            train(
                replace(run, recipe=override_training(short, seed=seed), folder=tmp_path / str(k))
            )
        )
        for k, seed in enumerate((5, 5, 6))
    ]
    assert same(made[0], made[1])
    assert not same(made[0], made[2])


def test_an_example_depends_on_seed_and_index_alone():
    task = toy.Discs()
    with (
        examples.open_example_source(task, 7, 4, 0) as here,
        examples.open_example_source(task, 7, 4, 2) as there,
    ):
        alone = here.iterate_batches(8, 4)
        shared = there.iterate_batches(8, 4)
        for _ in range(5):
            one = next(alone)
            other = next(shared)
            assert all(np.array_equal(one[name], other[name]) for name in one)
        assert [e["disc"].sum() for e in here.make_validation_set(5)["unseen_tools"]] == [
            e["disc"].sum() for e in there.make_validation_set(5)["unseen_tools"]
        ]
    whole = examples.make_batch(task, 7, 0, 8)
    assert np.array_equal(examples.make_batch(task, 7, 5, 1)["image"][0], whole["image"][5])


def test_a_run_is_neither_overwritten_nor_resumed_with_another_recipe(run):
    short = replace(run, recipe=override_training(run.recipe, steps=3))
    train(short)
    with pytest.raises(FileProblem, match="--resume"):
        train(short)
    with pytest.raises(SettingProblem, match=r"another recipe \(training.*'steps': 3.* before"):
        train(replace(run, resume=True))


def test_a_damaged_state_is_refused(run):
    short = replace(run, recipe=override_training(run.recipe, steps=3))
    train(short)
    file = run.folder / "state.pt"
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(FileProblem, match="damaged"):
        train(replace(short, resume=True))


def test_steps_without_a_finite_loss_are_skipped_and_end_the_run_when_they_stay(run, caplog):
    seldom = replace(run.recipe, settings=toy.Discs(noise=0.1, bad_from=95))
    done = train(replace(run, recipe=override_training(seldom, steps=30)))
    assert 0 < done.n_skipped == len([r for r in caplog.records if "is skipped" in r.message]) < 20
    assert all(np.isfinite(t).all() for t in tensors(done).values())
    always = replace(run.recipe, settings=toy.Discs(bad_from=0))
    with pytest.raises(NotConverged, match="10 steps"):
        train(replace(run, recipe=always, folder=run.folder.with_name("always")))
    assert state.load_state(run.folder.with_name("always")).step == 10


def test_a_run_starts_from_the_initial_weights_of_its_recipe(run, tmp_path, caplog):
    first = train(replace(run, recipe=override_training(run.recipe, steps=30)))
    save_weights(tmp_path / "first.safetensors", make_weights(first, "first"))
    none = replace(run.recipe, optimiser=replace(run.recipe.optimiser, learning_rate=0.0))
    none = override_training(none, initial_weights=str(tmp_path / "first.safetensors"), steps=1)
    lost = override_training(none, initial_weights=str(tmp_path / "lost.safetensors"))
    with pytest.raises(FileProblem, match=r"train them first, or give --from: .*lost\.safetensors"):
        train(replace(run, recipe=lost, folder=tmp_path / "lost"))
    again = train(replace(run, recipe=none, folder=tmp_path / "again"))
    assert same(tensors(again), tensors(first))
    assert "6 tensors start from" in caplog.text


def test_with_minutes_the_learning_rate_follows_the_clock_also_over_a_stop(run, monkeypatch):
    """The clock advances by a second on every call."""
    ticks = itertools.count()
    monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=lambda: float(next(ticks))))
    monkeypatch.setattr(loop, "LOG_INTERVAL_STEPS", 1)
    minutes = replace(run, max_minutes=2.0, resume=True)
    with pytest.raises(Cancelled):
        train(minutes, StopAt(15))
    stopped_s = state.load_state(run.folder).trained_s
    assert 15 < stopped_s < 60
    for _ in range(1000):  # time between the two parts does not count
        next(ticks)
    done = train(minutes)
    assert 120 <= done.trained_s < 140
    rates = [row["learning rate"] for row in done.curve]
    assert rates[-1] < 0.1 * max(rates)
    assert max(rates) == max(rates[:8])
    assert done.metrics[-1]["step"] == done.step


@pytest.mark.timeout(2 * LONG_S)
def test_a_killed_run_resumes_and_its_workers_end(recipe_file, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    recipe_file.write_text(toy.RECIPE.replace("steps = 60", "steps = 120"))
    out = tmp_path / "run"
    command = [sys.executable, program, "--recipe", recipe_file, "--out", out, "--workers", "1"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    killed = subprocess.Popen(
        command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True
    )
    end_s = time.monotonic() + LONG_S
    while not (out / "state.pt").exists() and time.monotonic() < end_s:
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait(LONG_S)
    step = state.load_state(out).step
    assert 0 < step < 120
    done = subprocess.run(
        [*command, "--resume"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    # this process has one thread as well: their number changes the last digits
    recipe = load_recipe(str(recipe_file), "discs")
    whole = train(TrainingRun(recipe=recipe, folder=tmp_path / "whole", n_workers=0))
    assert same(tensors(state.load_state(out)), tensors(whole))
    assert (out / "weights.safetensors").exists()


def test_cached_examples_are_made_once_and_survive_a_stop(run, tmp_path, monkeypatch):
    asked = []
    sample = toy.Discs.sample
    monkeypatch.setattr(toy.Discs, "sample", lambda self, rng: asked.append(1) or sample(self, rng))
    cached = replace(run, recipe=override_training(run.recipe, n_cached_examples=9, steps=20))
    whole = train(replace(cached, folder=tmp_path / "whole"))
    held_out = 2 * cached.recipe.validation.n_examples
    assert len(asked) == 12 + held_out  # whole batches of four
    with pytest.raises(Cancelled):
        train(replace(cached, resume=True), StopAt(7))
    stopped = train(replace(cached, resume=True))
    assert stopped.step == whole.step == 20
    assert same(tensors(stopped), tensors(whole))


def test_a_full_disk_is_a_warning_during_training(run, monkeypatch, caplog):
    monkeypatch.setattr(loop, "SAVE_INTERVAL_S", 0.0)
    save_state = state.save_state
    tried = []

    def full_at_first(folder, now):
        tried.append(now.step)
        if len(tried) < 3:
            raise FileProblem(
                "cannot write the training state (No space left on device)", folder / "state.pt"
            )
        save_state(folder, now)

    monkeypatch.setattr(state, "save_state", full_at_first)
    monkeypatch.setattr(
        state,
        "draw_curves",
        lambda folder, now: (_ for _ in ()).throw(FileProblem("full", folder)),
    )
    done = train(run)
    assert state.load_state(run.folder).step == done.step == run.recipe.training.steps
    assert sum("No space left" in message for message in caplog.messages) == 2


def test_a_full_disk_at_the_end_is_an_error(run, monkeypatch):
    def full(folder, now):
        raise FileProblem(
            "cannot write the training state (No space left on device)", folder / "state.pt"
        )

    monkeypatch.setattr(state, "save_state", full)
    with pytest.raises(FileProblem, match="No space left"):
        train(run)
