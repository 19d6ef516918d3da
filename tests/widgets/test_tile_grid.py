"""Tiles stand so that their pictures are as large as the room allows."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.views.colours import ColourScale
from pipeline.views.preview import Preview, Tile
from widgets.compare.tile_grid import TileGrid

SCALE = ColourScale(colour_map="viridis", low=0.0, high=1.0, unit="mm", quantity="indentation")


def _tiles(count, *, scaled=True):
    values = np.zeros((140, 175), np.float32)
    picture = Preview(
        pixels=np.zeros((140, 175, 3), np.uint8),
        frame_name="",
        values=values if scaled else None,
        scale=SCALE if scaled else None,
        caption="deviation from rest, + toward camera; rest: as described",
    )
    return [
        Tile(title=f"method {n}", subtitle="contact 0.381 mm", preview=picture)
        for n in range(count)
    ]


@pytest.fixture
def grid(qtbot):
    made = TileGrid()
    qtbot.addWidget(made)
    made.resize(1322, 494)
    made.show()
    return made


def test_six_low_pictures_stand_in_two_rows_with_their_words_beside(grid, qtbot):
    grid.show_tiles(_tiles(6))
    qtbot.waitUntil(lambda: grid.views[3].y() > grid.views[0].y(), timeout=240_000)
    view = grid.views[0].view
    qtbot.waitUntil(lambda: view.text_area.x() > view.canvas.x(), timeout=240_000)
    room = view.canvas.size()
    assert min(room.width() / 175, room.height() / 140) * 175 > 240  # a row of six had 208


def test_words_come_under_the_picture_again_where_that_is_larger(grid, qtbot):
    grid.show_tiles(_tiles(6))
    grid.show_tiles(_tiles(2))
    view = grid.views[0].view
    qtbot.waitUntil(lambda: view.text_area.y() > view.canvas.y(), timeout=240_000)
    assert grid.views[0].y() == grid.views[1].y()


def test_colours_that_mean_no_number_take_no_room_for_a_bar(grid):
    grid.show_tiles(_tiles(2, scaled=False))
    assert all(tile.view.colour_bar.isHidden() for tile in grid.views)
    grid.show_tiles(_tiles(2))
    assert not any(tile.view.colour_bar.isHidden() for tile in grid.views)


def test_how_tiles_stand_does_not_change_the_room_they_ask_for(grid, qtbot):
    """Else words next to it would make the grid lower, which puts them under, which makes it
    higher, and so for ever.
    """
    asked = grid.minimumSizeHint(), grid.sizeHint(), grid.hasHeightForWidth()
    for count in (6, 2, 9):
        grid.show_tiles(_tiles(count))
        assert (grid.minimumSizeHint(), grid.sizeHint(), grid.hasHeightForWidth()) == asked


def test_figures_that_fill_many_lines_are_all_seen_and_scales_stay_level(grid, qtbot):
    tiles = _tiles(6)
    figures = " \N{MIDDLE DOT} ".join(f"observable_{k}_mm 0.109" for k in range(8))
    tiles[0] = Tile(title="pose", subtitle=figures, preview=tiles[0].preview)
    grid.resize(1322, 600)
    grid.show_tiles(tiles)
    first, second = grid.views[:2]
    qtbot.waitUntil(lambda: first.view.text_area.x() > first.view.canvas.x(), timeout=240_000)
    qtbot.waitUntil(
        lambda: first._subtitle.height() >= first._subtitle.heightForWidth(first._subtitle.width()),
        timeout=240_000,
    )
    assert first.view.colour_bar.y() == second.view.colour_bar.y()
