"""A few real pairs: kept by number, the first ones learned from, moved a little each time."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.recordings import open_recording
from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.training.loop import TrainingRun, train
from pipeline.training.pair_files import TrainingPair, load_pairs, save_pair
from pipeline.training.pair_fine_tuning import PairFineTuningTask, jitter_pair, mix_colours
from pipeline.training.recipe import load_recipe

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
ROWS, COLS = 20, 28


def pair(number, channels=13):
    y, x = np.mgrid[:ROWS, :COLS]
    touch = 6.0 * np.exp(-((x - 8 - 2 * number) ** 2 + (y - 10) ** 2) / 20.0).astype(np.float32)
    shown = np.stack([touch / 6.0] * (channels - 1) + [np.ones_like(touch)]).astype(np.float32)
    return TrainingPair(condition=shown, indentation_mm=touch, contact=touch > 2.0)


@pytest.fixture
def folder(tmp_path):
    for number in range(5):
        save_pair(tmp_path, number, pair(number))
    return str(tmp_path)


def test_the_first_pairs_are_learned_from_and_the_others_held_out(folder):
    task = PairFineTuningTask(folder=folder, n_pairs=2)
    assert len(load_pairs(folder)) == 5
    held = [task.make_validation_example("unseen_tools", k)["residual"][0] for k in range(3)]
    for k, residual in enumerate(held):
        assert np.allclose(3.0 * residual, pair(2 + k).indentation_mm, atol=0.01)
    peaks = set()
    for seed in range(40):
        example = task.sample(np.random.default_rng(seed))
        assert example["condition"].shape == (13, ROWS, COLS)
        assert not example["contact"][1].any()
        peaks.add(int(example["residual"][0].max(0).argmax()))
    assert max(peaks) <= 13 < 16, "a held-out pair was learned from"
    assert len(peaks) > 3, "pairs are not moved"


def test_a_pair_is_moved_as_one(folder):
    one = pair(1)
    for seed in range(5):
        other = jitter_pair(one, np.random.default_rng(seed))
        alike = np.corrcoef(other.condition[0].ravel(), other.indentation_mm.ravel())[0, 1]
        assert alike > 0.999
        assert not np.array_equal(other.indentation_mm, one.indentation_mm)
        assert np.array_equal(other.contact, other.contact & (other.indentation_mm > 1.0))
        assert (other.condition[-1] == 1.0).all(), "where there is a reading is no brightness"


def test_colours_are_mixed_pixel_by_pixel_and_nothing_else():
    one = pair(1)
    coloured = replace(
        one, condition=np.concatenate([one.condition[:4], 0.0 * one.condition[4:12], one.condition[12:]])
    )
    other = mix_colours(coloured, np.random.default_rng(0), 0.25)
    peak = np.unravel_index(one.condition[0].argmax(), one.condition[0].shape)
    shares = [float(other.condition[4 * k][peak] / one.condition[0][peak]) for k in range(3)]
    assert 0.75 <= shares[0] <= 1.25
    assert all(0.0 < abs(share) <= 0.25 for share in shares[1:])
    for k in range(12):
        assert np.allclose(other.condition[k], shares[k // 4] * one.condition[0], atol=1e-6)
    assert np.array_equal(other.condition[12], one.condition[12])
    assert np.array_equal(other.indentation_mm, one.indentation_mm)


def test_no_pairs_are_one_sentence(tmp_path):
    with pytest.raises(FileProblem, match="no drawn pair"):
        PairFineTuningTask(folder=str(tmp_path)).sample(np.random.default_rng(0))


@pytest.mark.parametrize("alike", [0.0, 1.0])
def test_its_recipe_trains_a_network_that_touch_to_touch_takes(folder, tmp_path, alike):
    recipe = tmp_path / "few.toml"
    text = "\n".join([
        'task = "pair_fine_tuning"', "batch = 2", "steps = 3", "[network]", 'kind = "residual_denoiser"', "inputs = 13",
        "unit_mm = 3.0", "base_channels = 8", "levels = 2", "max_channels = 16", "sigma_max = 10.0", "noise_correlation = 0.125", "[settings]",
        f'folder = "{folder}"', "n_pairs = 3", f"correlation_weight = {alike}", "[validation]", "n_evaluations = 1", "n_examples = 2",
    ])  # fmt: skip
    recipe.write_text(text)
    found = train(TrainingRun(recipe=load_recipe(str(recipe), "t2t"), folder=tmp_path / "run", n_workers=0))
    assert found.step == 3
    names = {row["name"] for row in found.metrics}
    assert {"in contact, mm", "two samples apart in contact, mm"} <= names
    assert load_recipe("t2t_few_pairs", "t2t").network["inputs"] == 13


@pytest.mark.parametrize(("target", "channels"), [("soft_bubble", 13), ("gelslim", 3)])
def test_a_recording_of_both_sensors_gives_its_own_pairs(target, channels):
    task = PairFineTuningTask(target=target, recording=str(SAMPLE), n_pairs=1)
    example = task.make_validation_example("unseen_tools", 0)
    recording = open_recording(SAMPLE)
    truths = [recording.stream_of_sensor(target).truth(k) for k in range(recording.streams[0].n_frames)]
    recording.close()
    shape = make_working_sensor(load_sensor(target)).camera.shape
    assert example["condition"].shape == (channels, *shape)
    touch = example["residual"][0] * (3.0 if target == "soft_bubble" else 0.2)
    near = [float(np.abs(touch - resample_to_grid(t.indentation_mm, shape)).max()) for t in truths]
    assert min(near) < 1e-4
    assert example["contact"][0].any()


def test_a_recording_without_the_other_sensor_is_refused():
    with pytest.raises(SettingProblem, match="no pairs of"):
        PairFineTuningTask(recording=str(SAMPLE.with_name("digit_gelslim.h5"))).make_validation_example(
            "unseen_tools", 0
        )


def recorded(path, moments, gel=lambda frame: frame, pairings=True):
    """A recording of some of the sample's moments by either sensor."""
    with closing(open_recording(SAMPLE)) as sample, RecordingWriter(
        path, pairings=sample.pairings if pairings else (), depth_step_mm=0.05
    ) as writer:  # fmt: skip
        for name, indices in moments.items():
            stream = sample.stream(name)
            for index in indices:
                frame = stream.frame(index)
                writer.append(name, gel(frame) if name == "gelslim" else frame, stream.truth(index))
    return str(path)


def test_what_is_odd_about_own_pairs_is_said_before_they_are_learned_from(tmp_path):
    touched = range(3, 6)
    whole = recorded(tmp_path / "whole.h5", {"gelslim": touched, "soft_bubble": touched})
    assert PairFineTuningTask(recording=whole, n_pairs=2).collect_notes() == ()
    (alone,) = PairFineTuningTask(recording=whole, n_pairs=10).collect_notes()
    assert "all 3 pairs are learned from (10 were asked for), none is held out" in alone
    odd = recorded(
        tmp_path / "odd.h5", {"gelslim": [0, 3], "soft_bubble": [0, 3, 4]}, lambda f: replace(f, reference=None), False
    )
    told = "; ".join(PairFineTuningTask(recording=odd).collect_notes())
    for words in (
        "has 2 frames, Soft Bubble 3: the first 2", "does not say how its sensors stand",
        "no untouched reading of GelSlim (markers) is in", "1 of 2 moments are left out", "all 1 pairs",
    ):  # fmt: skip
        assert words in told, told


def test_pairs_whose_two_sides_are_of_other_touches_are_doubted_before_they_are_learned_from(tmp_path):
    y, x = np.mgrid[:ROWS, :COLS]
    rng, dents = np.random.default_rng(3), []
    for at_x, at_y, deep in zip(rng.uniform(4, 24, 20), rng.uniform(4, 16, 20), rng.uniform(2, 8, 20), strict=True):
        dents.append((deep * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / 8.0)).astype(np.float32))
    for name, order in (("own", range(20)), ("others", rng.permutation(20))):
        for number, other in enumerate(order):
            seen = np.stack([dents[number] / 8.0] * 12 + [np.ones((ROWS, COLS))]).astype(np.float32)
            touch = TrainingPair(condition=seen, indentation_mm=dents[other], contact=dents[other] > 1.0)
            save_pair(tmp_path / name, number, touch)
    assert PairFineTuningTask(folder=str(tmp_path / "own"), n_pairs=10).collect_notes() == ()
    (doubt,) = PairFineTuningTask(folder=str(tmp_path / "others"), n_pairs=10).collect_notes()
    assert "agree only by chance" in doubt
