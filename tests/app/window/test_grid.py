"""The grid of *Compare*: corners first, results live, cancellable; a click uses a cell."""

from __future__ import annotations

import math
import shlex

import pytest
from PyQt6.QtGui import QGuiApplication

from app.compare.comparison import ComparisonController
from app.compare.variant_jobs import list_axes, suggest_values
from app.session.sample import SAMPLE_RECORDING
from app.session.state import Session
from app.shell.tour import wait_until_shown
from pipeline.cli.main import build_app, run_app
from pipeline.core.errors import SettingProblem
from pipeline.core.params import Setting, list_settings
from pipeline.lab.evaluation.comparison_tiles import write_tiles
from pipeline.lab.evaluation.grid_comparison import (
    GridAxis,
    GridCell,
    GridPlan,
    build_tiles,
    parse_axis,
)
from pipeline.lab.evaluation.variants import Variant
from pipeline.translation.catalogue import BUILT_IN
from widgets.compare.comparison_grid import find_pareto_front

LIMIT_MS = 240_000


@pytest.fixture
def gridded(bubble_window, qtbot):
    """The grid of cloud density and largest triangle jump, two values each."""
    instrument = bubble_window
    instrument.window.comparison.show_tab("grid")
    instrument.window.actions_by_name["layout_compare"].trigger()
    instrument.window.comparison.show_tab("grid")
    assert wait_until_shown(instrument, 240)
    tab = instrument.window.comparison.grid
    qtbot.waitUntil(lambda: tab.axes[0].count() > 0, timeout=LIMIT_MS)
    _choose(tab, ("cloud.stride", "1, 4"), ("target_depth.jump_mm", "1, 2"))
    return instrument, tab


def _choose(tab, *axes):
    for box, line, (title, values) in zip(tab.axes, tab.values, axes, strict=True):
        box.setCurrentIndex(box.findData(title))
        assert box.choice == title
        box.chosen.emit(title)
        line.setText(values)


def _run(qtbot, instrument, tab, n_cells):
    tab.start_button.click()
    comparing = instrument.findChild(ComparisonController)
    qtbot.waitUntil(
        lambda: len(tab.grid.cells) == n_cells and not comparing.is_busy, timeout=LIMIT_MS
    )


def test_all_pairs_are_computed_and_a_click_uses_one(gridded, qtbot):
    instrument, tab = gridded
    assert instrument.latest_frame.results == {}  # nothing that nobody sees
    _run(qtbot, instrument, tab, 4)
    assert all(
        c.preview is not None and c.ms > 0 and math.isnan(c.error) for c in tab.grid.cells.values()
    )
    # other points
    assert (tab.grid.cells[0, 0].preview.pixels != tab.grid.cells[0, 1].preview.pixels).any()
    steps = instrument.undo_stack.count()
    tab.grid.cell_chosen.emit(1, 1)
    params = instrument.session.params
    assert params["cloud/back_projection"].stride == 4
    assert params["target_depth/surface"].jump_mm == 2.0
    assert instrument.undo_stack.count() == steps + 1
    assert wait_until_shown(instrument, 240)
    assert (tab.grid.currentRow(), tab.grid.currentColumn()) == (1, 1)
    assert len(tab.grid.cells) == 4, "it stays while its cells are tried"
    instrument.choose_frame(1)
    assert wait_until_shown(instrument, 240)
    assert tab.grid.cells == {}, "of another frame"


def test_a_cell_of_another_method_is_used_as_well(gridded, qtbot):
    instrument, tab = gridded
    _choose(tab, ("target_depth.method", "surface, paper"), ("", ""))
    _run(qtbot, instrument, tab, 2)
    tab.grid.cell_chosen.emit(0, 1)
    assert instrument.session.methods["target_depth"] == "paper"
    instrument.undo_stack.undo()
    assert "target_depth" not in instrument.session.methods


def test_the_copied_command_computes_the_same_pairs(gridded, qtbot, tmp_path, monkeypatch):
    instrument, tab = gridded
    monkeypatch.chdir(tmp_path)
    _run(qtbot, instrument, tab, 4)
    instrument.window.actions_by_name["copy_command"].trigger()
    words = shlex.split(QGuiApplication.clipboard().text())
    assert run_app(build_app(), words[1:]) == 0
    plan = GridPlan(
        across=GridAxis(stage="cloud", name="stride", values=(1, 4)),
        down=GridAxis(stage="target_depth", name="jump_mm", values=(1.0, 2.0)),
        metric="",
    )
    write_tiles(tmp_path / "shown", build_tiles(plan, list(tab.grid.cells.values())))
    shown, typed = (
        {p.name: p.read_bytes() for p in (tmp_path / name).iterdir()}
        for name in ("shown", "compared")
    )
    assert shown == typed
    assert len(shown) == 5


def test_a_sampled_touch_says_whether_its_error_is_variance_or_bias(open_window, qtbot):
    instrument = open_window(
        SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5, methods={"touch": "t2d2"}
    )
    instrument.window.actions_by_name["layout_compare"].trigger()
    instrument.window.comparison.show_tab("grid")
    assert wait_until_shown(instrument, 240), instrument.window.banner.text
    tab = instrument.window.comparison.grid
    qtbot.waitUntil(lambda: tab.axes[0].count() > 0, timeout=LIMIT_MS)
    _choose(tab, ("touch.seed", "0, 1"), ("touch.steps", "1, 2"))
    _run(qtbot, instrument, tab, 4)
    assert "touch.steps=1: every seed gives the same touch" in tab.message.text()
    assert "touch.steps=2: 2 samples have a standard deviation" in tab.message.text()
    assert all(math.isfinite(cell.error) for cell in tab.grid.cells.values())


def test_what_can_be_tried_is_of_the_methods_in_use(gridded, qtbot):
    """A bubble's depth comes from the network by default: the physics method's parameters would
    change nothing.
    """
    instrument, tab = gridded
    offered = {tab.axes[0].itemData(i) for i in range(tab.axes[0].count())}
    used = {f"{m.stage}.{name}" for m in instrument.methods for name in list_settings(m.params())}
    assert "network" in {m.name for m in instrument.methods if m.stage == "depth"}
    assert offered - used == {
        "depth.method",
        "depth.weights",
        "target_depth.method",
        "touch.method",
        "touch_depth.method",
        "pose.method",
    } | (offered & {"touch.weights", "pose.weights", "cloud.method"})


@pytest.mark.parametrize(
    ("route", "touch", "kind", "wanted"),
    [
        ("t2t", "t2t", "gel", ["touch.guidance", "touch.steps"]),
        ("t2d2", "t2d2", "bubble", ["touch.guidance", "touch.steps"]),
        ("t2d2", "physics", "gel", ["depth.certainty", "depth.pressure_share"]),
        ("t2d2", "physics", "bubble", ["depth.certainty", "target_depth.grazing_deg"]),
    ],
)
def test_a_grid_starts_with_the_most_effective_parameters_of_its_methods(
    route, touch, kind, wanted
):
    methods = BUILT_IN.methods(route, {"touch": touch})
    axes = list_axes(Session(), methods, BUILT_IN, {method.key: kind for method in methods})
    assert list(axes)[:2] == wanted
    if touch != "physics":  # where guidance and steps act
        guidance, steps = ([float(value) for value in axes[title].split(",")] for title in wanted)
        assert (min(steps), max(steps), min(guidance), max(guidance)) == (4, 50, 1.0, 7.0)


def test_invalid_values_are_explained_and_nothing_starts(gridded, qtbot):
    _, tab = gridded
    for values, fact in (("1, none", "stride"), ("0", "stride"), ("", "stride")):
        tab.values[0].setText(values)
        tab.start_button.click()
        assert fact in tab.message.text()
    _choose(tab, ("target_depth.jump_mm", "1, 2"), ("target_depth.jump_mm", "1, 2"))
    tab.start_button.click()
    qtbot.waitUntil(lambda: "try the same" in tab.message.text(), timeout=LIMIT_MS)
    assert tab.grid.cells == {}


def test_corners_come_first_and_every_cell_once():
    across, down = (GridAxis(stage="a", name=name, values=(1, 2, 3)) for name in "xy")
    order = GridPlan(across=across, down=down, metric="").run_order
    assert set(order[:4]) == {(0, 0), (0, 2), (2, 0), (2, 2)}
    assert sorted(order) == [(r, c) for r in range(3) for c in range(3)]


def test_suggested_values_stay_within_limits_and_typed_ones_are_checked(bubble_window):
    setting = Setting(label="x", low=0.5, high=3.0)
    values = suggest_values(2.0, setting)
    assert min(values) >= 0.5
    assert max(values) <= 3.0
    assert 2.0 in values
    assert suggest_values(True, setting) == (False, True)
    base = Variant(label="", translation=bubble_window.views.translation, params={})
    assert parse_axis(base, "cloud.stride = 2,3, 2").values == (2, 3)
    with pytest.raises(SettingProblem):
        parse_axis(base, "cloud.stride=1.5")


def test_no_cell_beats_the_pareto_front():
    def cell(error: float, ms: float) -> GridCell:
        return GridCell(row=0, col=0, error=error, ms=ms)

    cells = [cell(3.0, 1.0), cell(2.0, 2.0), cell(2.5, 3.0), cell(math.nan, 0.5)]
    assert find_pareto_front(cells) == cells[:2]
