"""A few recorded pairs: the first ones are trained on, jittered on every use."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.recordings import open_recording
from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.sensors.spec import load_sensor
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.residual_render import resample_to_grid
from pipeline.training import pair_fine_tuning
from pipeline.training.loop import TrainingRun, train
from pipeline.training.pair_fine_tuning import PairFineTuningTask, jitter_pair
from pipeline.training.recipe import load_recipe
from pipeline.training.recorded_pairs import RecordedPairs, TrainingPair

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
ROWS, COLS = 20, 28


def make_pair(index, channels=13):
    y, x = np.mgrid[:ROWS, :COLS]
    touch = 6.0 * np.exp(-((x - 8 - 2 * index) ** 2 + (y - 10) ** 2) / 20.0).astype(np.float32)
    condition = np.stack([touch / 6.0] * (channels - 1) + [np.ones_like(touch)]).astype(np.float32)
    return TrainingPair(condition=condition, indentation_mm=touch, contact=touch > 2.0)


@pytest.fixture
def use_pairs(monkeypatch):
    """Give the task these pairs in place of a recording's."""

    def use(pairs):
        recorded = RecordedPairs(pairs=tuple(pairs), notes=())
        monkeypatch.setattr(pair_fine_tuning, "load_recorded_pairs", lambda *_: recorded)

    return use


def test_the_first_pairs_are_trained_on_and_the_others_validate(use_pairs):
    use_pairs(make_pair(k) for k in range(5))
    task = PairFineTuningTask(n_pairs=2)
    for k in range(3):
        residual = task.make_validation_example("unseen_tools", k)["residual"][0]
        assert np.allclose(3.0 * residual, make_pair(2 + k).indentation_mm, atol=0.01)
    peaks = set()
    for seed in range(40):
        example = task.sample(np.random.default_rng(seed))
        assert example["condition"].shape == (13, ROWS, COLS)
        assert not example["contact"][1].any()
        peaks.add(int(example["residual"][0].max(0).argmax()))
    assert max(peaks) <= 13 < 16, "a validation pair is trained on"
    assert len(peaks) > 3, "pairs are not jittered"


def test_condition_and_touch_of_a_pair_are_jittered_together():
    pair = make_pair(1)
    for seed in range(5):
        other = jitter_pair(pair, np.random.default_rng(seed))
        assert np.corrcoef(other.condition[0].ravel(), other.indentation_mm.ravel())[0, 1] > 0.999
        assert not np.array_equal(other.indentation_mm, pair.indentation_mm)
        assert np.array_equal(other.contact, other.contact & (other.indentation_mm > 1.0))
        assert (other.condition[-1] == 1.0).all(), "the mask is brightened"


def test_the_recipe_trains_a_network_of_touch_to_touch(use_pairs, tmp_path):
    use_pairs(make_pair(k) for k in range(5))
    recipe = tmp_path / "few.toml"
    recipe.write_text("\n".join([
        'task = "pair_fine_tuning"', "batch = 2", "steps = 3", "[network]", 'kind = "residual_denoiser"', "inputs = 13",
        "unit_mm = 3.0", "base_channels = 8", "levels = 2", "max_channels = 16", "sigma_max = 10.0",
        "noise_correlation = 0.125", "[settings]", "n_pairs = 3", "[validation]", "n_evaluations = 1", "n_examples = 2",
    ]))  # fmt: skip
    state = train(TrainingRun(recipe=load_recipe(str(recipe), "t2t"), folder=tmp_path / "run", n_workers=0))
    assert state.step == 3
    names = {row["name"] for row in state.metrics}
    assert {"error in contact, mm", "difference of two samples in contact, mm"} <= names
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


def write_recording(path, moments, gel=lambda frame: frame, pairings=True):
    """Write some moments of the sample recording."""
    with closing(open_recording(SAMPLE)) as sample, RecordingWriter(
        path, pairings=sample.pairings if pairings else (), depth_step_mm=0.05
    ) as writer:  # fmt: skip
        for name, indices in moments.items():
            stream = sample.stream(name)
            for index in indices:
                frame = stream.frame(index)
                writer.append(name, gel(frame) if name == "gelslim" else frame, stream.truth(index))
    return str(path)


def test_notes_name_what_was_assumed_and_left_out(tmp_path):
    touched = range(3, 6)
    whole = write_recording(tmp_path / "whole.h5", {"gelslim": touched, "soft_bubble": touched})
    assert PairFineTuningTask(recording=whole, n_pairs=2).collect_notes() == ()
    (note,) = PairFineTuningTask(recording=whole, n_pairs=10).collect_notes()
    assert "all 3 pairs" in note
    assert "10 requested" in note
    odd = write_recording(
        tmp_path / "odd.h5", {"gelslim": [0, 3], "soft_bubble": [0, 3, 4]}, lambda f: replace(f, reference=None), False
    )
    notes = "; ".join(PairFineTuningTask(recording=odd).collect_notes())
    for words in (
        "2 frames, Soft Bubble 3: the first 2", "no target_from_source", "no reference image of GelSlim (markers)",
        "1 of 2 moments", "all 1 pairs",
    ):  # fmt: skip
        assert words in notes, notes


def test_pairs_of_different_touches_give_a_warning(use_pairs):
    y, x = np.mgrid[:ROWS, :COLS]
    rng, dents = np.random.default_rng(3), []
    for at_x, at_y, deep in zip(rng.uniform(4, 24, 20), rng.uniform(4, 16, 20), rng.uniform(2, 8, 20), strict=True):
        dents.append((deep * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / 8.0)).astype(np.float32))

    def collect_notes(order):
        use_pairs(
            TrainingPair(
                condition=np.stack([dent / 8.0] * 12 + [np.ones((ROWS, COLS))]).astype(np.float32),
                indentation_mm=dents[other], contact=dents[other] > 1.0,
            )
            for dent, other in zip(dents, order, strict=True)
        )  # fmt: skip
        return PairFineTuningTask(n_pairs=10).collect_notes()

    assert collect_notes(range(20)) == ()
    assert len(collect_notes(rng.permutation(20))) == 1
