"""Recorded pairs as training examples: folders in the layout of the published set, and
recordings.
"""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.values.frames import Truth
from pipeline.io import open_recording
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.evaluation.held_out import select_recorded
from pipeline.lab.training.denoising import TouchToTouchTask, jitter_example
from pipeline.lab.training.depth_anything import DepthAnythingTask
from pipeline.lab.training.loop import TrainingRun, train
from pipeline.lab.training.recipe import (
    RECIPES_FOLDER,
    list_shipped_recipes,
    load_recipe,
    override_pairs,
    override_training,
)
from pipeline.lab.training.recorded_pairs import (
    PairFolder,
    PairTask,
    derive_contact,
    open_pairs,
    use_pairs,
)
from pipeline.lab.training.square_tasks import LatentTask, VqVaeTask
from pipeline.lab.training.touch_pose import TouchPoseTask
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.depth_anything import DepthAnything
from pipeline.stages.networks.weights import Weights, save_weights
from pipeline.stages.touch.residual_diffusion import resample_to_grid
from pipeline.stages.touch.t2d2 import make_working_sensor
from tests.pipeline.io.test_tensors import depth_dictionary, saved
from tests.pipeline.io.touch2touch_files import write_grasps

SAMPLE = Path(__file__).parents[4] / "sample_data" / "recordings" / "first_touch.h5"
TOOLS = ("hex", "peg", "rod", "star")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The sample's touches as grasps of four tools, in a folder of the published layout."""
    root = tmp_path_factory.mktemp("touch2touch") / "data"
    for k, tool in enumerate(TOOLS):
        write_grasps(SAMPLE, root / "train", tool, first=10 * k)
    return root


def test_both_fingers_of_a_grasp_have_one_role(data):
    pairs = open_pairs(PairFolder(path=str(data), hold_out="rod"), "gelslim", "soft_bubble")
    names = {role: {p.grasp.name for p in places} for role, places in pairs.places.items()}
    assert set(names) == {"training", "unseen_grasps", "unseen_tools"}
    assert not names["training"] & names["unseen_grasps"]
    assert {name.split()[0] for name in names["unseen_tools"]} == {"rod"}
    for places in pairs.places.values():
        streams = [(p.source_stream.name, p.target_stream.name) for p in places]
        assert set(streams) == {
            ("gelslim right", "soft_bubble right"),
            ("gelslim left", "soft_bubble left"),
        }
        assert len(places) == 2 * len({p.grasp.name for p in places})


@pytest.mark.parametrize(
    "task",
    [
        TouchToTouchTask(),
        LatentTask(side=64),
        LatentTask(target="gelslim", condition="reprojected"),
        VqVaeTask(reprojects_input=True),
        VqVaeTask(target="gelslim", augmentation_share=0.5),
    ],
    ids=lambda task: f"{type(task).__name__} to {task.pair_sensors[1]}",
)
def test_examples_of_pairs_have_the_arrays_of_simulated_ones(task, data):
    pairs = use_pairs(task, PairFolder(path=str(data), hold_out="rod"))
    one, again = (pairs.make_validation_example("unseen_tools", 1) for _ in range(2))
    assert all(np.array_equal(one[key], again[key]) for key in one)
    simulated = task.make_validation_example("unseen_tools", 1)
    assert {k: (a.shape, a.dtype) for k, a in one.items()} == {
        k: (a.shape, a.dtype) for k, a in simulated.items()
    }
    sampled = pairs.sample(np.random.default_rng(0))
    assert sampled.keys() <= one.keys()
    assert all(a.shape == one[key].shape for key, a in sampled.items())
    assert all(np.isfinite(a).all() for a in one.values())


def test_depth_trains_on_the_published_depth_files_with_contact_from_indentation(tmp_path):
    for tool, split in (("hex", "train"), ("hex", "val"), ("peg", "test")):
        saved(tmp_path / f"{tool}_{split}.pt", depth_dictionary())
    pairs = use_pairs(DepthAnythingTask(side=28), PairFolder(path=str(tmp_path)))
    assert pairs.collect_notes()[0] == (
        "3 grasps are trained on, 3 validate as unseen grasps, 3 validate as unseen tools (peg)"
    )
    example = pairs.make_validation_example("unseen_tools", 0)
    simulated = DepthAnythingTask(side=28).make_validation_example("unseen_tools", 0)
    assert {k: (a.shape, a.dtype) for k, a in example.items()} == {
        k: (a.shape, a.dtype) for k, a in simulated.items()
    }
    truth = Truth(indentation_mm=np.array([[0.0, 0.01, 1.5, np.nan]], np.float32))
    assert derive_contact(truth, load_sensor("gelslim")).tolist() == [[False, False, True, False]]


def test_truth_of_a_recording_is_what_is_trained_on():
    target = "soft_bubble"
    pairs = PairTask(task=TouchToTouchTask(), folder=PairFolder(path=str(SAMPLE)))
    example = pairs.make_validation_example("unseen_grasps", 0)
    with closing(open_recording(SAMPLE)) as recording:
        stream = recording.stream_of_sensor(target)
        truths = [stream.truth(k) for k in range(stream.n_frames)]
    shape = make_working_sensor(load_sensor(target)).camera.shape
    assert example["condition"].shape == (14, *shape)
    touch = example["residual"][0] * 3.0
    assert (
        min(float(np.abs(touch - resample_to_grid(t.indentation_mm, shape)).max()) for t in truths)
        < 1e-4
    )
    assert example["contact"][0].any()


def test_lost_frames_are_paired_by_their_times(tmp_path):
    """The gel lost two frames: each of its touches is trained and scored with the bubble's at
    the same time.
    """
    path = tmp_path / "lost.h5"
    kept = [0, 1, 3, 4, 6, 7]
    with (
        closing(open_recording(SAMPLE)) as sample,
        RecordingWriter(path, depth_step_mm=0.05) as writer,
    ):
        for name, indices in {"gelslim": kept, "soft_bubble": range(8)}.items():
            stream = sample.stream(name)
            for index in indices:
                writer.append(name, stream.frame(index), stream.truth(index))
        times = [sample.stream("gelslim").frame(index).time_s for index in range(8)]
    pairs = open_pairs(PairFolder(path=str(path)), "gelslim", "soft_bubble")
    places = sorted(
        (place for of_role in pairs.places.values() for place in of_role), key=lambda p: p.index
    )
    assert [(p.index, p.target_index) for p in places] == list(enumerate(kept))
    for place in places:
        pair = pairs.load(place)
        assert pair.source_frame.time_s == pair.target_frame.time_s == times[kept[place.index]]
    assert any(
        "6 frames of gelslim and soft_bubble are paired by their times" in note
        for note in pairs.notes
    )
    (selected,) = select_recorded(pairs, "training")
    assert [kept[k] for k in selected.frames] == list(selected.target_frames)


def test_one_tool_has_no_unseen_tools_and_training_does_without(tmp_path):
    recipe = tmp_path / "few.toml"
    recipe.write_text(
        "\n".join(
            [
                'task = "touch_to_touch"',
                "batch = 2",
                "steps = 3",
                "[network]",
                'kind = "residual_denoiser"',
                "inputs = 13",
                "unit_mm = 3.0",
                "base_channels = 8",
                "levels = 2",
                "max_channels = 16",
                "sigma_max = 10.0",
                "noise_correlation = 0.125",
                "[validation]",
                "n_evaluations = 1",
                "n_examples = 2",
            ]
        )
    )
    chosen = override_pairs(load_recipe(str(recipe), "t2t"), str(SAMPLE), "")
    state = train(TrainingRun(recipe=chosen, folder=tmp_path / "run", n_workers=0))
    assert state.step == 3
    assert {row["split"] for row in state.metrics} == {"unseen_grasps"}
    assert chosen.plain_values["data"] == {"pairs": str(SAMPLE), "hold_out": ""}
    assert chosen.network["trained_on_recordings"], (
        "physics at the described alignment would replace what was learned"
    )


def test_depth_of_a_gelslim_is_adapted_to_a_digit_by_a_tenth_of_its_touches(tmp_path):
    text = (
        (RECIPES_FOLDER / "depth_anything_digit.toml")
        .read_text()
        .replace("side = 224", "side = 28")
    )
    (tmp_path / "digit.toml").write_text(
        text.replace("batch = 4", "batch = 1") + "[validation]\nn_examples = 1\n"
    )
    gelslim = DepthAnything(encoder="vits", side=28)
    save_weights(
        tmp_path / "gelslim.safetensors",
        Weights(
            name="gelslim",
            kind="depth_anything",
            config={"encoder": "vits", "side": 28, "answer": "metric"},
            tensors={name: tensor.numpy() for name, tensor in gelslim.state_dict().items()},
            card={"task": "depth_anything"},
        ),
    )
    started = load_recipe(
        str(tmp_path / "digit.toml"), "depth", str(tmp_path / "gelslim.safetensors")
    )
    sample = SAMPLE.with_name("digit_gelslim.h5")
    chosen = override_training(override_pairs(started, str(sample), "", 0.1), steps=1)
    task = use_pairs(chosen.settings, chosen.pairs)
    whole = use_pairs(chosen.settings, PairFolder(path=str(sample)))
    assert (
        task.count_validation_examples("unseen_grasps")
        == whole.count_validation_examples("unseen_grasps")
        > 0
    )
    assert "share of 0.1" in " ".join(task.collect_notes())
    state = train(TrainingRun(recipe=chosen, folder=tmp_path / "run", n_workers=0))
    moved = max(
        float((t - gelslim.state_dict()[n]).abs().max()) for n, t in state.network_tensors.items()
    )
    assert 0.0 < moved < 1e-3, "it starts from the weights of the GelSlim"
    assert {row["split"] for row in state.metrics} == {"unseen_grasps"}


@pytest.mark.parametrize("name", [name for name in list_shipped_recipes() if "_pairs" in name])
def test_recipes_of_pairs_start_from_shipped_weights(name):
    what = name.partition("_")[0]
    if what == "latent":  # of which none is shipped
        with pytest.raises(FileProblem, match=r"train them first, or give --from"):
            load_recipe(name, what)
        return
    recipe = load_recipe(name, what)
    assert recipe.network["kind"] in ("residual_denoiser", "vqvae")
    assert recipe.training.initial_weights
    assert hasattr(recipe.settings, "make_pair_example")


def test_condition_and_touch_of_a_pair_are_jittered_together():
    y, x = np.mgrid[:20, :28]
    touch = 6.0 * np.exp(-((x - 10) ** 2 + (y - 10) ** 2) / 20.0).astype(np.float32)
    condition = np.stack([touch / 6.0] * 12 + [np.ones_like(touch)]).astype(np.float32)
    contact = np.stack([touch > 2.0, touch > 9.0]).astype(np.float32)
    pair = {
        "condition": condition,
        "residual": np.stack([touch, contact[0]]),
        "contact": contact,
    }
    for seed in range(5):
        other = jitter_example(pair, np.random.default_rng(seed))
        moved = other["residual"][0]
        assert np.corrcoef(other["condition"][0].ravel(), moved.ravel())[0, 1] > 0.999
        assert not np.array_equal(moved, touch)
        assert np.array_equal(other["residual"][1], other["contact"][0])
        assert moved[other["contact"][0] > 0].min() > 1.0
        assert not other["contact"][1].any()
        assert (other["condition"][-1] == 1.0).all(), "the mask is brightened"


def test_what_holds_no_pairs_and_tasks_without_pairs_are_refused():
    folder = PairFolder(path=str(SAMPLE.with_name("digit_gelslim.h5")))
    with pytest.raises(SettingProblem, match="no pairs of"):
        open_pairs(folder, "gelslim", "soft_bubble")
    with pytest.raises(SettingProblem, match="does not train on pairs"):
        use_pairs(TouchPoseTask(), folder)


def test_notes_name_what_was_held_out_and_assumed(tmp_path):
    path = tmp_path / "odd.h5"
    with (
        closing(open_recording(SAMPLE)) as sample,
        RecordingWriter(path, depth_step_mm=0.05) as writer,
    ):
        for name, indices in {"gelslim": [0, 3], "soft_bubble": [0, 3, 4]}.items():
            stream = sample.stream(name)
            for index in indices:
                frame = stream.frame(index)
                writer.append(
                    name,
                    replace(frame, reference=None) if name == "gelslim" else frame,
                    stream.truth(index),
                )
    notes = "; ".join(
        PairTask(task=TouchToTouchTask(), folder=PairFolder(path=str(path))).collect_notes()
    )
    for words in (
        "1 grasps are trained on, 1 validate as unseen grasps, 0 validate as unseen tools",
        "2 frames of gelslim and soft_bubble are paired by their times; 1 of soft_bubble have no "
        "partner",
        "no target_from_source",
        "gelslim has no reference image",
    ):
        assert words in notes, notes
