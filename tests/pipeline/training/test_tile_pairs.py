"""Folders of difference tiles as training pairs: roles, orientation, the loss, and a training of two steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.imprints.image_rotation import orient_image
from pipeline.training.loop import TrainingRun, train
from pipeline.training.recipe import load_recipe, override_pairs, override_training
from pipeline.training.recorded_pairs import PairFolder
from pipeline.training.tile_pairs import holds_tiles, open_tiles, use_tiles
from pipeline.training.touch_to_touch import TouchToTouchTask
from pipeline.training.vqvae import VqVaeTask
from tests.pipeline.imprints.test_tiles import tile

NAMES = (*(f"training_{k:02}_bar_{k % 2}" for k in range(7)), "center_generalization_07_bar_0")
SHARE = 0.86  # of seven pairs: six
SMALL = {"kind": "residual_denoiser", "unit_mm": 3.0, "base_channels": 8, "levels": 2, "max_channels": 8, "fold": 4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Eight pairs in the published layout, each in an orientation of its own, one with another no-change grey."""
    root = tmp_path_factory.mktemp("tiles")
    write_tiles(root, orientations=range(8))
    return root


def make_folder(root: Path) -> PairFolder:
    return PairFolder(path=str(root), share=SHARE)


def write_tiles(root: Path, orientations) -> None:
    for k, (name, orientation) in enumerate(zip(NAMES, orientations, strict=True)):
        touching, image = tile(k)
        # The imprint's bubble sees half as much again on every side, so that a gel's tile is a part of its own.
        wide = cv2.GaussianBlur(cv2.resize(np.pad(touching, 64, mode="edge"), (128, 128)), (0, 0), 3)
        image = image // 4 if k == 3 else image
        for which, pixels in (("gelslim", image[..., ::-1]), ("bubble_gt", (200 * wide).astype(np.uint8))):
            cv2.imwrite(str(root / f"{name}_{which}.png"), np.ascontiguousarray(orient_image(pixels, orientation)))


@pytest.mark.parametrize("sensors", [("gelslim", "soft_bubble"), ("soft_bubble", "gelslim")])
def test_all_pairs_that_are_not_trained_on_validate(folder, sensors):
    tiles = open_tiles(make_folder(folder), *sensors)
    assert len(tiles.training) == 6
    assert len(tiles.held_out["unseen_grasps"]) == 2
    shapes = {touch.condition.shape[1:] for touch in (*tiles.training, *tiles.held_out["unseen_grasps"])}
    assert shapes == {tiles.mean_imprint.shape}
    assert any("1 of 8 tiles are jittered" in note and NAMES[3] in note for note in tiles.notes)


def test_the_orientation_of_tiles_changes_nothing(folder, tmp_path):
    write_tiles(tmp_path, orientations=[0] * 8)
    turned, upright = (open_tiles(make_folder(root), "gelslim", "soft_bubble") for root in (folder, tmp_path))
    for one, other in zip(turned.training, upright.training, strict=True):
        np.testing.assert_allclose(one.indentation_mm, other.indentation_mm, atol=0.02)
        np.testing.assert_allclose(one.condition, other.condition, atol=0.02)


def test_the_loss_is_that_of_likeness_beyond_the_mean_imprint(folder):
    import torch

    task = use_tiles(TouchToTouchTask(), make_folder(folder))
    examples = [task.make_validation_example("unseen_grasps", 0)]
    batch = {name: torch.from_numpy(np.stack([example[name] for example in examples])) for name in examples[0]}
    mean = torch.from_numpy(np.array(open_tiles(task.folder, *task.sensors).mean_imprint))

    class Answer(torch.nn.Module):
        sigma_max = 10.0

        def __init__(self, answer):
            super().__init__()
            self.answer = answer

        def forward(self, *_inputs):
            return self.answer

    def measure(answer):
        return float(task.compute_loss(Answer(torch.cat([answer, 0 * answer[:, :1]], 1)), batch)[1]["unlike"])

    true = batch["residual"]
    assert measure(2.0 * true + 3.0) == pytest.approx(0.0, abs=1e-4)
    assert measure(-true) == pytest.approx(2.0, abs=1e-4)
    assert measure(mean.expand_as(true)) > 0.9


@pytest.mark.parametrize(("recipe", "inputs"), [("t2t_tiles", 13), ("t2t_tiles_gelslim", 3)])
def test_one_command_trains_on_a_folder_of_tiles(folder, tmp_path, recipe, inputs):
    chosen = override_pairs(load_recipe(recipe, "t2t"), str(folder), "", SHARE)
    chosen = override_training(replace(chosen, network={**SMALL, "inputs": inputs}), steps=2, initial_weights="")
    state = train(TrainingRun(recipe=chosen, folder=tmp_path / "run", n_workers=0))
    figures = {row["name"]: row["value"] for row in state.metrics if row["step"] == 2}
    assert state.n_skipped == 0
    assert set(figures) == {
        "partial correlation", "partial correlation of one view", "correlation of the mean imprint",
    }  # fmt: skip
    assert all(0.0 < abs(value) < 1.0 for value in figures.values())


def test_tiles_train_touch_to_touch_alone(folder):
    assert holds_tiles(PairFolder(path=str(folder)))
    assert not holds_tiles(PairFolder(path=str(folder.parent)))
    with pytest.raises(SettingProblem, match="train t2t alone"):
        use_tiles(VqVaeTask(), PairFolder(path=str(folder)))
