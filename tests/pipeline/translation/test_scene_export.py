"""The scene and the presentation as files: pictures of any size, and films."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.core.errors import SettingProblem
from pipeline.translation.reports.export import export_file
from pipeline.translation.reports.export_request import (
    PRESENTATION,
    SCENE,
    ExportRequest,
    format_command,
)
from pipeline.translation.reports.scene_film import FILM_RATE_HZ
from pipeline.translation.reports.video import count_frames, write_video
from pipeline.translation.translate import Request
from pipeline.views.press_motion import DURATION_S

SAMPLE = Path(__file__).resolve().parents[3] / "sample_data" / "recordings" / "first_touch.h5"
REQUEST = Request(recording=SAMPLE, source="gelslim", target="soft_bubble")
N_IMAGES = round(FILM_RATE_HZ * DURATION_S)


def _export(path: Path, pane: str = SCENE, **more) -> Path:
    asked = ExportRequest(request=REQUEST, pane=pane, frame=5, path=path)
    export_file(replace(asked, **more))
    return path


def test_a_scene_is_a_picture_of_any_size(tmp_path):
    picture = cv2.imread(str(_export(tmp_path / "scene.png", size_px=(400, 300))))
    assert picture.shape == (300, 400, 3)
    # both cameras in their colours, blue green red
    for colour in ((0, 159, 230), (233, 180, 86)):
        near = np.abs(picture.astype(int) - colour).max(axis=-1) < 40
        assert near.sum() > 100


@pytest.mark.parametrize("suffix", [".webm", ".webp"])
def test_the_press_is_a_film_that_ends_where_it_begins(tmp_path, suffix):
    path = _export(tmp_path / f"press{suffix}", size_px=(160, 120))
    if suffix == ".webp":
        _, film = cv2.imreadanimation(str(path))
        # equal images after each other are one that lasts longer
        assert sum(film.durations) == N_IMAGES * round(1000.0 / FILM_RATE_HZ)
        images = [image[:, :, :3] for image in film.frames]
    else:
        reader = cv2.VideoCapture(str(path))
        images = [reader.read()[1] for _ in range(N_IMAGES)]
    assert len(images) > 0.9 * N_IMAGES
    assert images[0].shape == (120, 160, 3)
    images = [cv2.GaussianBlur(image.astype(np.float32), None, 6.0) for image in images]
    changes = [np.abs(image - images[0]).mean() for image in images]
    assert changes[-1] < 0.5 * max(changes)


def test_a_presentation_has_source_scene_and_both_touches(tmp_path):
    path = _export(tmp_path / "shown.png", PRESENTATION, size_px=(960, 540))
    columns = np.array_split(cv2.imread(str(path)), 3, axis=1)
    ground = columns[0][2, 2].astype(int)
    filled = [(np.abs(part - ground).max(axis=-1) > 12).mean() for part in columns]
    assert min(filled[0], filled[2]) > 0.4
    assert 0.02 < filled[1] < 0.6
    halves = np.array_split(columns[2], 2)
    assert min((half.max(axis=-1) > 150).mean() for half in halves) > 0.3, "generated over recorded"


def test_without_truth_nothing_is_empty(tmp_path):
    asked = replace(REQUEST, target="digit")
    path = _export(tmp_path / "shown.png", PRESENTATION, size_px=(960, 540), request=asked)
    column = np.array_split(cv2.imread(str(path)), 3, axis=1)[2]
    bright = column.max(axis=-1) > 150
    assert bright[: len(bright) // 2].mean() == pytest.approx(
        bright[len(bright) // 2 :].mean(), abs=0.15
    )


def test_what_a_scene_cannot_be_is_told(tmp_path):
    with pytest.raises(SettingProblem, match=r"no pane 'scene' as \.ply"):
        _export(tmp_path / "scene.ply")
    with pytest.raises(SettingProblem, match="64 to 8192 pixels"):
        _export(tmp_path / "scene.png", size_px=(10, 300))
    with pytest.raises(SettingProblem, match="--size out for depth"):
        _export(tmp_path / "depth.png", "depth", size_px=(100, 300))
    with pytest.raises(SettingProblem, match="presentation has no truth"):
        _export(tmp_path / "shown.png", PRESENTATION, content="truth")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("levels", [[0], [0, 0], [0, 0, 9, 9]])
def test_an_animation_may_be_of_one_image_or_of_equal_ones(tmp_path, levels):
    path = tmp_path / "still.webp"
    write_video(path, (np.full((64, 64, 3), 20 * level, np.uint8) for level in levels), 10.0)
    assert count_frames(path) == len(set(levels))
    path.write_bytes(path.read_bytes()[:-8])
    assert count_frames(path) == 0


def test_the_command_names_the_size():
    asked = ExportRequest(request=REQUEST, pane=SCENE, size_px=(400, 300), path=Path("scene.png"))
    assert "--pane scene" in format_command(asked)
    assert "--size 400 300" in format_command(asked)
