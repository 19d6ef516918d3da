"""Compare: one frame by several methods."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QPointF

from app.compare.comparison import ComparisonController
from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.stages.networks import network_factory, weights_registry
from pipeline.stages.touch.stage import OBJECT, PHYSICS, T2D2
from tests.app.window.command_runs import same_as_typed

LIMIT_S = 240
LIMIT_MS = 240_000


@pytest.fixture
def compared(open_window, qtbot, tmp_path, monkeypatch):
    """*Compare* on a touched frame, with the weights of one method alone."""
    for name in ("t2d2_bubble.safetensors", "t2d2_bubble.md"):
        (tmp_path / name).symlink_to(weights_registry.WEIGHTS_FOLDER / name)
    monkeypatch.setattr(weights_registry, "WEIGHTS_FOLDER", tmp_path)
    instrument = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(instrument, LIMIT_S), instrument.window.banner.text
    instrument.window.actions_by_name["layout_compare"].trigger()
    assert wait_until_shown(instrument, LIMIT_S)
    comparing = next(
        child for child in instrument.children() if isinstance(child, ComparisonController)
    )
    qtbot.waitUntil(lambda: not comparing.is_busy and bool(_tiles(instrument)), timeout=LIMIT_MS)
    return instrument, comparing


def _tiles(instrument):
    return instrument.window.comparison.current_tab.grid.tiles


def _settled(qtbot, instrument, comparing, tiles):
    qtbot.waitUntil(
        lambda: instrument.is_idle and not comparing.is_busy and _tiles(instrument) is not tiles,
        timeout=LIMIT_MS,
    )


def test_a_recording_that_does_not_open_leaves_no_tiles_of_the_one_before(compared, tmp_path):
    instrument, comparing = compared
    bad = tmp_path / "bad.h5"
    bad.write_bytes(b"damaged")
    instrument.open_path(bad)
    wait_until_shown(instrument, LIMIT_S)
    assert "bad.h5" in instrument.window.banner.text
    assert not _tiles(instrument)
    assert not instrument.window.comparison.current_tab.message.text()
    assert not comparing.is_busy
    instrument.window.banner.buttons[0].click()
    assert wait_until_shown(instrument, LIMIT_S)
    assert comparing.is_busy, "the same tiles are computed again"


def test_every_method_is_compared_with_ground_truth_worst_first(compared, qtbot):
    instrument, comparing = compared
    page = instrument.window.comparison
    tiles = _tiles(instrument)
    titles = [tile.title for tile in tiles]
    assert titles[0] == "truth"
    assert set(titles[1:]) == {PHYSICS.title, T2D2.title, OBJECT.title}
    assert tiles[1].metrics["contact_error_mm"] > tiles[2].metrics["contact_error_mm"]
    assert all(
        "contact" in tile.subtitle and "dB" in tile.subtitle and "ms" in tile.subtitle
        for tile in tiles[1:]
    )
    assert "left out: T2D2 latent" in page.current_tab.message.text()
    assert len({tile.preview.scale for tile in tiles}) == 1  # one colour scale
    # nothing is worked out for columns that nobody sees
    assert instrument.latest_frame.results == {}
    page.order_box.setCurrentText("best first")
    page.choice_changed.emit()
    _settled(qtbot, instrument, comparing, tiles)
    assert [tile.title for tile in _tiles(instrument)] == ["truth", *reversed(titles[1:])]


def test_the_copied_command_makes_the_same_pictures_and_figures(compared, tmp_path, monkeypatch):
    instrument, _ = compared
    same_as_typed(instrument, tmp_path, monkeypatch)


def test_leaving_the_page_releases_cached_results_and_networks(compared, qtbot):
    instrument, comparing = compared
    # pyright: ignore[reportPrivateUsage]
    tiles = _tiles(instrument)
    ready = network_factory._predictors
    cache = comparing._method_runner.graph.cache
    assert cache.n_bytes
    assert len(ready)
    comparing.release_memory()
    assert cache.n_bytes, "the page is visible"
    instrument.window.actions_by_name["layout_look"].trigger()
    instrument.choose_method("touch", "physics")  # the page alone has used the network
    assert wait_until_shown(instrument, LIMIT_S)
    qtbot.waitUntil(lambda: not comparing.is_busy, timeout=LIMIT_MS)
    assert comparing._release_timer.isActive()
    comparing.release_memory()
    assert (cache.n_bytes, len(ready)) == (0, 0)
    instrument.window.actions_by_name["layout_compare"].trigger()
    _settled(qtbot, instrument, comparing, tiles)
    assert not comparing._release_timer.isActive()
    assert [tile.title for tile in _tiles(instrument)] == [tile.title for tile in tiles]


def test_one_key_shows_the_difference_and_all_views_pan_together(compared):
    instrument, _ = compared
    views = instrument.window.comparison.current_tab.grid.views
    instrument.window.actions_by_name["show_difference"].trigger()
    assert wait_until_shown(instrument, LIMIT_S)
    assert all(v.view.preview is v.tile.difference for v in views[1:])
    assert views[0].view.preview is views[0].tile.preview
    views[1].view.canvas.set_view(QPointF(100.0, 60.0), 2.0)
    views[1].view.view_changed.emit()
    assert {
        (v.view.canvas.centre.x(), v.view.canvas.centre.y(), v.view.canvas.scale) for v in views
    } == {(100, 60, 2)}
    views[2].view.pixel_hovered.emit(60, 100)
    assert all(v.view.canvas.crosshair == (60, 100) for v in views)
    assert views[2].tile.title in instrument.window.readout.text()


def test_another_frame_is_followed_and_a_hidden_page_computes_nothing(compared, qtbot):
    instrument, comparing = compared
    tiles = _tiles(instrument)
    instrument.choose_frame(6)
    _settled(qtbot, instrument, comparing, tiles)
    assert "frame 6" in instrument.window.comparison.current_tab.message.text()
    instrument.window.actions_by_name["layout_look"].trigger()
    assert wait_until_shown(instrument, LIMIT_S)
    tiles = _tiles(instrument)
    instrument.choose_frame(5)
    assert wait_until_shown(instrument, LIMIT_S)
    assert not comparing.is_busy
    assert _tiles(instrument) is tiles
