"""The loop: the same weights however a run is stopped, whoever makes its examples, and loud where nothing is learned."""

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

from pipeline.base.errors import FileProblem, NotConverged, SettingProblem
from pipeline.base.progress import Cancelled
from pipeline.networks.weights import save_weights
from pipeline.training import examples, loop, state
from pipeline.training.export import make_weights
from pipeline.training.loop import TrainingRun, train
from pipeline.training.recipe import load_recipe, override_training
from tests.pipeline.training import toy

ROOT = Path(__file__).parents[3]
LONG_S = 280  # beyond any machine at rest, and most that are busy
PROGRAM = """
import sys
from pipeline.cli.main import build_app, run_app
from pipeline.training import loop
from tests.pipeline.training import toy
if __name__ == "__main__":
    toy.known()
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
    return TrainingRun(recipe=load_recipe(str(recipe_file), "discs"), folder=tmp_path / "run", n_workers=0)


def tensors(run_state):
    return make_weights(run_state, "x").tensors


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a) and a.keys() == b.keys()


def rows(folder, name):
    with (folder / name).open() as file:
        return [{k: v for k, v in row.items() if k != "minutes"} for row in csv.DictReader(file)]


def test_a_run_that_was_stopped_ends_with_the_weights_and_curves_of_one_that_was_not(run, tmp_path):
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


def test_something_is_learned_and_the_average_is_what_is_judged(run):
    done = train(run)
    first, last = done.metrics[0]["value"], done.metrics[-1]["value"]
    assert last > max(0.8, first)
    assert done.curve[-1]["loss"] < 0.5 * done.curve[0]["loss"]
    assert (run.folder / "curve.png").stat().st_size > 1000
    assert not same(tensors(done), {name: t.numpy() for name, t in done.network_tensors.items()})


def test_another_seed_gives_other_weights_and_the_same_seed_the_same(run, tmp_path):
    short = override_training(run.recipe, steps=4)
    made = [
        tensors(train(replace(run, recipe=override_training(short, seed=seed), folder=tmp_path / str(k))))
        for k, seed in enumerate((5, 5, 6))
    ]
    assert same(made[0], made[1])
    assert not same(made[0], made[2])


def test_an_example_depends_on_seed_and_number_alone():
    task = toy.Discs()
    with examples.open_example_source(task, 7, 4, 0) as here, examples.open_example_source(task, 7, 4, 2) as there:
        alone, shared = here.iterate_batches(8, 4), there.iterate_batches(8, 4)
        for _ in range(5):
            one, other = next(alone), next(shared)
            assert all(np.array_equal(one[name], other[name]) for name in one)
        assert [e["disc"].sum() for e in here.make_validation_set(5)["unseen_tools"]] == [
            e["disc"].sum() for e in there.make_validation_set(5)["unseen_tools"]
        ]
    whole = examples.make_batch(task, 7, 0, 8)
    assert np.array_equal(examples.make_batch(task, 7, 5, 1)["picture"][0], whole["picture"][5])


def test_a_run_is_not_written_over_nor_gone_on_with_by_another_recipe(run):
    short = replace(run, recipe=override_training(run.recipe, steps=3))
    train(short)
    with pytest.raises(FileProblem, match="give --resume to go on"):
        train(short)
    with pytest.raises(SettingProblem, match=r"begun with another recipe \(training.*'steps': 3.* before"):
        train(replace(run, resume=True))


def test_a_damaged_state_is_one_sentence(run):
    short = replace(run, recipe=override_training(run.recipe, steps=3))
    train(short)
    file = run.folder / "state.pt"
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(FileProblem, match="the state of the training is damaged"):
        train(replace(short, resume=True))


def test_a_loss_that_is_no_number_is_left_out_loudly_and_ends_the_run_when_it_stays(run, caplog):
    seldom = replace(run.recipe, settings=toy.Discs(noise=0.1, bad_from=95))
    done = train(replace(run, recipe=override_training(seldom, steps=30)))
    assert 0 < done.n_skipped == len([r for r in caplog.records if "is left out" in r.message]) < 20
    assert all(np.isfinite(t).all() for t in tensors(done).values())
    always = replace(run.recipe, settings=toy.Discs(bad_from=0))
    with pytest.raises(NotConverged, match="no number for 10 steps"):
        train(replace(run, recipe=always, folder=run.folder.with_name("always")))
    assert state.load_state(run.folder.with_name("always")).step == 10


def test_a_run_begins_with_learned_weights_where_the_recipe_says_so(run, tmp_path, caplog):
    first = train(replace(run, recipe=override_training(run.recipe, steps=30)))
    save_weights(tmp_path / "first.safetensors", make_weights(first, "first"))
    none = replace(run.recipe, optimiser=replace(run.recipe.optimiser, learning_rate=0.0))
    none = override_training(none, initial_weights=str(tmp_path / "first.safetensors"), steps=1)
    again = train(replace(run, recipe=none, folder=tmp_path / "again"))
    assert same(tensors(again), tensors(first))
    assert "begun with 6 tensors of" in caplog.text


def test_by_minutes_the_learning_rate_ends_with_the_clock_also_over_a_stop(run, monkeypatch):
    """On a clock that goes on by a second whenever it is looked at."""
    ticks = itertools.count()
    monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=lambda: float(next(ticks))))
    monkeypatch.setattr(loop, "LOG_INTERVAL_STEPS", 1)
    minutes = replace(run, max_minutes=2.0, resume=True)
    with pytest.raises(Cancelled):
        train(minutes, StopAt(15))
    stopped_s = state.load_state(run.folder).trained_s
    assert 15 < stopped_s < 60
    for _ in range(1000):  # what passes between the two parts does not count
        next(ticks)
    done = train(minutes)
    assert 120 <= done.trained_s < 140
    rates = [row["learning rate"] for row in done.curve]
    assert rates[-1] < 0.1 * max(rates)
    assert max(rates) == max(rates[:8])
    assert done.metrics[-1]["step"] == done.step


@pytest.mark.timeout(2 * LONG_S)
def test_a_run_that_was_killed_goes_on_and_its_workers_are_gone(recipe_file, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    recipe_file.write_text(toy.RECIPE.replace("steps = 60", "steps = 120"))
    out = tmp_path / "run"
    command = [sys.executable, program, "--recipe", recipe_file, "--out", out, "--workers", "1"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    killed = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True)
    end_s = time.monotonic() + LONG_S
    while not (out / "state.pt").exists() and time.monotonic() < end_s:
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait(LONG_S)
    step = state.load_state(out).step
    assert 0 < step < 120
    done = subprocess.run(
        [*command, "--resume"], env=environment, capture_output=True, text=True, timeout=LONG_S, check=False
    )
    assert done.returncode == 0, done.stderr
    # In a process of its own too: how many threads add up changes the last digits.
    whole = tmp_path / "whole"
    subprocess.run([*command[:-3], whole, "--workers", "0"], env=environment, capture_output=True, check=True)
    assert same(tensors(state.load_state(out)), tensors(state.load_state(whole)))
    assert (out / "weights.safetensors").exists()


def test_examples_that_are_kept_are_made_once_and_a_stopped_run_goes_on_as_if_it_had_not_been(
    run, tmp_path, monkeypatch
):
    asked = []
    sample = toy.Discs.sample
    monkeypatch.setattr(toy.Discs, "sample", lambda self, rng: asked.append(1) or sample(self, rng))
    keeps = replace(run, recipe=override_training(run.recipe, n_cached_examples=9, steps=20))
    whole = train(replace(keeps, folder=tmp_path / "whole"))
    held_out = 2 * keeps.recipe.validation.n_examples
    assert len(asked) == 12 + held_out  # whole batches of four
    with pytest.raises(Cancelled):
        train(replace(keeps, resume=True), StopAt(7))
    stopped = train(replace(keeps, resume=True))
    assert stopped.step == whole.step == 20
    assert same(tensors(stopped), tensors(whole))


def test_a_recipe_that_keeps_nothing_is_told_as_before_there_was_such_a_thing(run):
    assert "n_cached_examples" not in run.recipe.plain_values["training"]
    assert override_training(run.recipe, n_cached_examples=5).plain_values["training"]["n_cached_examples"] == 5


def test_a_disk_that_is_full_for_a_while_ends_no_training_and_is_said(run, monkeypatch, caplog):
    monkeypatch.setattr(loop, "SAVE_INTERVAL_S", 0.0)
    kept, tried = state.save_state, []

    def full_at_first(folder, now):
        tried.append(now.step)
        if len(tried) < 3:
            raise FileProblem("cannot write the state of the training (No space left on device)", folder / "state.pt")
        kept(folder, now)

    monkeypatch.setattr(state, "save_state", full_at_first)
    monkeypatch.setattr(
        loop.curves, "draw_curves", lambda folder, now: (_ for _ in ()).throw(FileProblem("full", folder))
    )
    done = train(run)
    assert state.load_state(run.folder).step == done.step == run.recipe.training.steps
    assert sum("No space left" in message for message in caplog.messages) == 2


def test_a_disk_that_stays_full_is_told_at_the_end(run, monkeypatch):
    def full(folder, now):
        raise FileProblem("cannot write the state of the training (No space left on device)", folder / "state.pt")

    monkeypatch.setattr(state, "save_state", full)
    with pytest.raises(FileProblem, match="No space left"):
        train(run)
