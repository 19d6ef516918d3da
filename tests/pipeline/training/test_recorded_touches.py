"""Recordings as training examples: touches with truth, presses of a ball, and recordings that are refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.physics import gel, optics
from pipeline.sensors.spec import load_sensor
from pipeline.training import recipe, recorded_touches
from pipeline.training.depth_anything import DepthAnythingTask
from pipeline.training.examples import make_batch
from pipeline.training.recorded_touches import LabelledTouch, MixedTask, RecordingSource, mix_recordings
from tests.pipeline.training import toy

ROOT = Path(__file__).parents[3]
SAMPLE = RecordingSource(path=str(ROOT / "sample_data" / "recordings" / "first_touch.h5"), sensor="digit")
MINI = load_sensor("gelsight_mini")
BALL_MM = 6.31
DEEP_MM = 0.5
MAX_ERROR = 0.06  # share of the depth, from the calibration table and the image's noise


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """Images of a ball pressed into a Mini's gel, and the simulated surfaces."""
    folder, rng, surfaces = tmp_path_factory.mktemp("balls"), np.random.default_rng(3), []
    shape = MINI.camera.shape
    cv2.imwrite(str(folder / "background.png"), optics.render(MINI, np.zeros(shape, np.float32), seed=50)[..., ::-1])
    for k in range(6):
        x, y = float(rng.uniform(90, shape[1] - 90)), float(rng.uniform(80, shape[0] - 80))
        r_mm = MINI.pixel_mm * np.hypot(np.arange(shape[1]) - x, (np.arange(shape[0]) - y)[:, None])
        overlap = DEEP_MM - BALL_MM / 2 + np.sqrt(np.maximum((BALL_MM / 2) ** 2 - r_mm**2, 0.0))
        pressed = gel.press_gel(MINI.gel, MINI.pixel_mm, overlap)
        surfaces.append(pressed)
        cv2.imwrite(str(folder / f"{k}.png"), optics.render(MINI, pressed.indentation_mm, seed=k)[..., ::-1])
    return folder, surfaces


def test_the_mechanics_of_the_layer_give_the_surface_under_a_ball(balls):
    folder, surfaces = balls
    mine = RecordingSource(path=str(folder), sensor="gelsight_mini", diameter_mm=BALL_MM)
    assert recorded_touches.count_touches(mine) == len(surfaces)
    for index in range(recorded_touches.count_touches(mine)):
        known = recorded_touches.load_touch(mine, index)
        truth = surfaces[int(Path(known.frame.origin).stem)]
        assert known.indentation_mm.max() == pytest.approx(DEEP_MM, rel=MAX_ERROR)
        both, either = (known.contact & truth.contact).sum(), (known.contact | truth.contact).sum()
        assert both / either > 0.92
        off = np.abs(known.indentation_mm - truth.indentation_mm)
        assert off[truth.contact].mean() < MAX_ERROR * DEEP_MM


def test_a_recorded_touch_makes_the_same_arrays_as_a_simulated_one():
    task = DepthAnythingTask(sensor="digit", side=56)
    simulated, known = (
        task.sample(np.random.default_rng(0)),
        recorded_touches.load_touch(SAMPLE, recorded_touches.count_touches(SAMPLE) // 2),
    )
    made = task.make_touch_example(known, np.random.default_rng(1))
    assert {name: (a.shape, a.dtype) for name, a in made.items()} == {
        name: (a.shape, a.dtype) for name, a in simulated.items()
    }
    assert (made["contact"] > 0).mean() > 0.5 * known.contact.mean()


class Learns(toy.Discs):
    def make_touch_example(self, known: LabelledTouch, rng):
        return {"image": np.full((1, 16, 16), 5.0, np.float32), "disc": np.zeros((1, 16, 16), np.float32)}


def test_a_share_of_the_examples_is_recorded_and_examples_stay_reproducible():
    task = mix_recordings(Learns(), (SAMPLE,), 0.3)
    assert isinstance(task, MixedTask)
    images = make_batch(task, 4, 0, 200)["image"]
    recorded = (images == 5.0).all(axis=(1, 2, 3))
    assert 0.2 < recorded.mean() < 0.4
    assert np.array_equal(make_batch(task, 4, 150, 20)["image"], images[150:170])
    assert np.array_equal(
        task.make_validation_example("unseen_tools", 1)["disc"],
        toy.Discs().make_validation_example("unseen_tools", 1)["disc"],
    )
    plain = toy.Discs()
    assert mix_recordings(plain, (), 0.3) is plain


def test_unusable_recordings_are_refused(tmp_path):
    with pytest.raises(SettingProblem, match="Discs"):
        mix_recordings(toy.Discs(), (SAMPLE,), 0.3)
    with pytest.raises(FileProblem):
        mix_recordings(Learns(), (RecordingSource(path=str(tmp_path / "missing.h5"), sensor="digit"),), 0.3)
    image = np.full((20, 30, 3), 80, np.uint8)
    for name in ("background.png", "a.png"):
        cv2.imwrite(str(tmp_path / name), image)
    with pytest.raises(FileProblem, match="truth"):
        mix_recordings(Learns(), (RecordingSource(path=str(tmp_path), sensor="digit"),), 0.3)


def test_paths_of_recordings_are_relative_to_the_recipe(tmp_path):
    text = toy.RECIPE + '\n[data]\nrecorded_share = 0.4\n[[data.recordings]]\npath = "a/b.h5"\nsensor = "digit"\n'
    (tmp_path / "r.toml").write_text(text)
    made = recipe.load_recipe(str(tmp_path / "r.toml"))
    assert (made.recorded_share, made.recordings) == (
        0.4,
        (RecordingSource(path=str(tmp_path / "a" / "b.h5"), sensor="digit"),),
    )
    assert made.plain_values["data"]["recorded_share"] == 0.4
    for old, new, sentence in (
        ('path = "a/b.h5"', "", r"must name its path"), ("sensor", "sensr", r"\[\[data.recordings\]\] no parameter"),
        ("recorded_share = 0.4", "recorded_shar = 0.4", r"\[data\] no parameter 'recorded_shar'"), ("recorded_share = 0.4", "recorded_share = 4", "share must lie"),
        ("[[data.recordings]]", "[data.recordings]", "data.recordings: expected a list, got a table"),
    ):  # fmt: skip
        (tmp_path / "r.toml").write_text(text.replace(old, new))
        with pytest.raises(FileProblem, match=sentence):
            recipe.load_recipe(str(tmp_path / "r.toml"))
