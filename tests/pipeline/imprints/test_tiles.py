"""Difference tiles tell how they were laid, and pairs of tiles are found by their names."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.imprints.agreement import compute_correlation
from pipeline.imprints.image_rotation import ORIENTATIONS, orient_image, rotate_half_turn
from pipeline.imprints.tiles import detect_ridges, load_tile_pairs
from pipeline.physics.optics import compute_colour_change
from pipeline.sensors.spec import load_sensor
from tests.pipeline.imprints.scenes import strokes

SPEC = load_sensor("gelslim")
BACK = {k: next(j for j in ORIENTATIONS if np.array_equal(orient_image(orient_image(np.arange(9).reshape(3, 3), k), j),
                                                  np.arange(9).reshape(3, 3))) for k in ORIENTATIONS}  # fmt: skip


def tile(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(what touches, the difference picture of it as a training set keeps it), 128 px wide."""
    touching = cv2.resize(strokes(seed), (128, 128), interpolation=cv2.INTER_LINEAR)
    return touching, change_of(touching, seed)


def change_of(touching: np.ndarray, seed: int) -> np.ndarray:
    """The difference picture of what touches (128, 128)."""
    seen = SPEC.with_camera(SPEC.camera.resize(128, 128))
    surface = 0.4 * cv2.GaussianBlur(touching, (0, 0), 3)
    gy, gx = np.gradient(surface, seen.pixel_mm)
    change = compute_colour_change(seen, gx.astype(np.float32), gy.astype(np.float32))
    change = change + np.random.default_rng(seed).normal(0, 2, change.shape)
    low, high = np.percentile(change, (0.5, 99.5))
    return np.clip((change - low) / (high - low) * 255, 0, 255).astype(np.uint8)


def test_half_a_turn_twice_is_none():
    picture = np.arange(12).reshape(3, 4)
    for way in ORIENTATIONS:
        assert rotate_half_turn(rotate_half_turn(way)) == way
        np.testing.assert_array_equal(
            orient_image(picture, rotate_half_turn(way)), orient_image(picture, way)[::-1, ::-1]
        )


@pytest.mark.parametrize("way", ORIENTATIONS)
def test_a_tile_tells_how_it_was_laid_and_where_it_is_touched(way: int):
    touching, picture = tile(way)
    found = detect_ridges(np.ascontiguousarray(orient_image(picture, way)), SPEC)
    assert found.orientation == BACK[way]
    assert found.curl_free > found.next_best
    assert compute_correlation(found.contact, touching) > 0.7


def test_a_sensor_without_lights_has_no_tiles():
    with pytest.raises(SettingProblem, match="has no LEDs"):
        detect_ridges(tile(0)[1], load_sensor("soft_bubble"))


def write(folder: Path, *, turns: bool) -> None:
    for k in range(4):
        touching, picture = tile(k)
        way = k if turns else 0
        cv2.imwrite(str(folder / f"{k}_gelslim.png"), np.ascontiguousarray(orient_image(picture, way))[..., ::-1])
        cv2.imwrite(
            str(folder / f"{k}_bubble_gt.png"), np.ascontiguousarray(orient_image((200 * touching).astype("u1"), way))
        )


@pytest.mark.parametrize("turns", [False, True])
def test_tiles_are_paired_by_name_and_laid_alike(tmp_path: Path, turns: bool):
    write(tmp_path, turns=turns)
    found = load_tile_pairs(tmp_path, SPEC, "*_gelslim.png", "*_bubble_gt.png")
    assert [p.name for p in found.pairs] == ["0", "1", "2", "3"]
    for k, pair in enumerate(found.pairs):
        np.testing.assert_allclose(pair.imprint, (200 * tile(k)[0]).astype("u1"))
    assert ("4 orientations" in found.notes[0]) == turns


def test_tiles_that_do_not_pair_are_refused(tmp_path: Path):
    write(tmp_path, turns=False)
    with pytest.raises(FileProblem, match=r"no two images are named \*_gelslim\.png and \*_other\.png"):
        load_tile_pairs(tmp_path, SPEC, "*_gelslim.png", "*_other.png")
    with pytest.raises(FileProblem, match=r"one '\*'"):
        load_tile_pairs(tmp_path, SPEC, "gelslim.png", "*_other.png")


@pytest.mark.parametrize("late", [0, 5])
def test_tiles_that_are_paired_with_those_of_other_touches_are_doubted(tmp_path, late):
    spots = np.random.default_rng(4).uniform(30, 98, (16, 2))
    for number, (x, y) in enumerate(spots):
        touching = np.zeros((128, 128), np.float32)
        cv2.circle(touching, (round(x), round(y)), 12, 1.0, -1)
        other = (number + late) % len(spots)
        cv2.imwrite(str(tmp_path / f"{number:02d}_gel.png"), change_of(touching, number)[..., ::-1])
        cv2.imwrite(str(tmp_path / f"{other:02d}_imprint.png"), 255 * cv2.GaussianBlur(touching, (0, 0), 4))
    notes = " ".join(load_tile_pairs(tmp_path, SPEC, "*_gel.png", "*_imprint.png").notes)
    assert ("agree only by chance" in notes) is bool(late)
