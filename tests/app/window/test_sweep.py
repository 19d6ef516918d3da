"""Parameter sweep: corners first, results live, cancellable; a click uses a cell."""

from __future__ import annotations

import math
import shlex

import pytest
from PyQt6.QtGui import QGuiApplication

from app.session.state import Session
from app.window.sweep import run_sweep
from app.window.tour import wait_until_shown
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter, LatestJob
from app.work.variants import choose_default_axes, list_sweepable_parameters, suggest_values
from pipeline.base.errors import SettingProblem
from pipeline.base.params import Setting, list_settings
from pipeline.cli.main import build_app, run_app
from pipeline.evaluation.comparison_tiles import write_tiles
from pipeline.evaluation.parameter_sweep import SweepAxis, SweepCell, SweepPlan, build_tiles, parse_axis
from pipeline.stages.cloud.stage import STAGE as CLOUD
from pipeline.translation.catalogue import BUILT_IN
from widgets.sweep_grid import find_pareto_front

LIMIT_MS = 240_000


@pytest.fixture
def swept(bubble_window, qtbot):
    """A sweep of cloud density and largest triangle jump, two values each."""
    instrument = bubble_window
    instrument.window.actions_by_name["layout_sweep"].trigger()
    assert wait_until_shown(instrument, 240)
    page = instrument.window.comparison.sweep
    for which, (words, values) in enumerate((("cloud.stride", "1, 4"), ("target_depth.jump_mm", "1, 2"))):
        page.axes[which].setCurrentText(words)
        page.axes[which].chosen.emit(words)
        page.values[which].setText(values)
    return instrument, page


def test_all_pairs_are_computed_and_a_click_uses_one(swept, qtbot):
    instrument, page = swept
    assert instrument.latest_frame.results == {}  # nothing that nobody sees
    page.start_button.click()
    qtbot.waitUntil(lambda: len(page.grid.cells) == 4, timeout=LIMIT_MS)
    qtbot.waitUntil(page.start_button.isEnabled, timeout=LIMIT_MS)
    assert all(t.preview is not None and t.ms > 0 and math.isnan(t.error) for t in page.grid.cells.values())
    assert (page.grid.cells[0, 0].preview.pixels != page.grid.cells[0, 1].preview.pixels).any()  # other points
    steps = instrument.undo_stack.count()
    page.grid.cell_chosen.emit(1, 1)
    params = instrument.session.params
    assert params["cloud/back_projection"].stride == 4
    assert params["target_depth/surface"].jump_mm == 2.0
    assert instrument.undo_stack.count() == steps + 1
    assert page.grid.used_cell == page.plot.used_cell == (1, 1)


def test_the_copied_command_computes_the_same_pairs(swept, qtbot, tmp_path, monkeypatch):
    instrument, page = swept
    monkeypatch.chdir(tmp_path)
    page.start_button.click()
    qtbot.waitUntil(lambda: len(page.grid.cells) == 4, timeout=LIMIT_MS)
    instrument.window.actions_by_name["copy_command"].trigger()
    words = shlex.split(QGuiApplication.clipboard().text())
    assert run_app(build_app(), words[1:]) == 0
    plan = SweepPlan(across=SweepAxis(key="cloud/back_projection", name="stride", values=(1, 4)),
                down=SweepAxis(key="target_depth/surface", name="jump_mm", values=(1.0, 2.0)), metric="")  # fmt: skip
    cells = list(page.grid.cells.values())
    write_tiles(tmp_path / "shown", build_tiles(plan, cells))
    shown, typed = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in ("shown", "swept"))
    assert shown == typed
    assert len(shown) == 5


def test_only_parameters_of_the_methods_in_use_are_offered(swept, qtbot):
    """A bubble's depth comes from the network by default: the physics method's parameters would change nothing."""
    instrument, page = swept
    used = {f"{m.stage}.{name}" for m in instrument.methods for name in list_settings(m.params())}
    assert "network" in {m.name for m in instrument.methods if m.stage == "depth"}
    assert {page.axes[0].itemText(i) for i in range(page.axes[0].count())} <= used
    axes = (SweepAxis(key="depth/physics", name=name, values=(1,)) for name in ("one", "other"))
    plan = SweepPlan(across=next(axes), down=next(axes), metric="")
    with pytest.raises(SettingProblem, match="'physics'"):
        run_sweep(Evaluator(), instrument.session, plan, JobReporter(LatestJob("never", instrument), 0))


@pytest.mark.parametrize(
    ("route", "touch", "kind", "wanted"),
    [
        ("t2t", "t2t", "gel", ("touch.guidance", "touch.steps")),
        ("t2d2", "t2d2", "bubble", ("touch.guidance", "touch.steps")),
        ("t2d2", "physics", "gel", ("depth.certainty", "depth.pressure_share")),
        ("t2d2", "physics", "bubble", ("depth.certainty", "target_depth.grazing_deg")),
    ],
)
def test_a_sweep_starts_with_the_most_effective_parameters_of_its_methods(route, touch, kind, wanted):
    methods = BUILT_IN.methods(route, {"touch": touch})
    offers = list_sweepable_parameters(Session(), methods, {method.key: kind for method in methods})
    axes = [offers[i] for i in choose_default_axes(offers)]
    assert tuple(axis[2] for axis in axes) == wanted
    if touch != "physics":  # where guidance and steps act
        guidance, steps = (suggest_values(value, setting) for *_, value, setting in axes)
        assert (min(steps), max(steps), min(guidance), max(guidance)) == (4, 50, 1.0, 7.0)


def test_invalid_values_are_explained_and_nothing_starts(swept):
    _, page = swept
    for values, fact in (("1, none", "stride"), ("0", "stride"), ("", "stride")):
        page.values[0].setText(values)
        page.start_button.click()
        assert fact in page.message.text()
        assert page.start_button.isEnabled()
    page.axes[0].setCurrentText("target_depth.jump_mm")
    page.values[0].setText("1, 2")
    page.start_button.click()
    assert "same parameter" in page.message.text()


def test_corners_come_first_and_every_cell_once():
    plan = SweepPlan(across=SweepAxis(key="a/b", name="x", values=(1, 2, 3)), down=SweepAxis(key="a/b", name="y", values=(1, 2, 3)),
                metric="")  # fmt: skip
    order = plan.run_order
    assert set(order[:4]) == {(0, 0), (0, 2), (2, 0), (2, 2)}
    assert sorted(order) == [(r, c) for r in range(3) for c in range(3)]


def test_suggested_values_stay_within_limits_and_typed_ones_are_checked(bubble_window):
    setting = Setting(label="x", low=0.5, high=3.0)
    values = suggest_values(2.0, setting)
    assert min(values) >= 0.5
    assert max(values) <= 3.0
    assert 2.0 in values
    assert suggest_values(True, setting) == (False, True)
    method = CLOUD.methods[0]
    assert parse_axis(method.params(), method, "stride", " 2,3, 2").values == (2, 3)
    with pytest.raises(SettingProblem):
        parse_axis(method.params(), method, "stride", "1.5")


def test_no_cell_beats_the_pareto_front():
    def cell(error: float, ms: float) -> SweepCell:
        return SweepCell(row=0, col=0, error=error, ms=ms, preview=None)

    cells = {(0, 0): cell(3.0, 1.0), (0, 1): cell(2.0, 2.0), (1, 0): cell(2.5, 3.0), (1, 1): cell(math.nan, 0.5)}
    assert find_pareto_front(cells) == [(0, 0), (0, 1)]
