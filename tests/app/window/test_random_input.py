"""Random input for a while: no exception, no stuck or blank column, no growing memory.

What happens in which order depends on how fast the machine is, so that no landing waits for it:
`make monkey` and `make slow` run it.
"""

from __future__ import annotations

import logging
import os
import random

import pytest

from app.shell.tour import wait_until_shown
from pipeline.cli.terminal import print_line
from tests.app.window.monkey import Monkey

AS_USERS_HAVE_IT = True
LIMIT_S = 240
_MINUTES_OF_LOADING = 5.0  # networks and libraries load meanwhile; memory is judged in longer runs


@pytest.mark.slow
def test_random_input_breaks_nothing(open_window, tmp_path, touch_file, ball_file, monkeypatch):
    """`make monkey` lets it run for an hour."""
    # pytest would keep every record of it
    monkeypatch.setattr(logging.getLogger("tactoscope"), "propagate", False)
    window = open_window(touch_file, gl=True, target="gelslim", frame=2)
    assert wait_until_shown(window, LIMIT_S), window.window.banner.text
    seed = int(os.environ.get("MONKEY_SEED", "1"))
    minutes = float(os.environ.get("MONKEY_MINUTES", "0.15"))
    monkey = Monkey(window, random.Random(seed), folder=tmp_path, good=(touch_file, ball_file))
    monkey.play(minutes * 60.0)
    watched = monkey.watched
    print_line(
        f"seed {seed}, {monkey.n_acts} acts, {watched.panes_looked_at} panes looked at, "
        f"{watched.solids_drawn} "
        f"3D pictures, {watched.n_cancelled} times cancelled, memory growth "
        f"{watched.growth_mb():+.0f} MB"
    )
    for seconds, process, kept in watched.memory_mb[:: max(1, len(watched.memory_mb) // 20)]:
        print_line(
            f"{seconds / 60:6.1f} min {process:6.0f} MB, {kept:5.0f} MB of it kept on purpose"
        )
    for complaint in monkey.complaints:
        print_line(complaint)
    assert monkey.complaints == []
    assert monkey.n_acts > 10
    assert watched.solids_drawn > 0
    if minutes > _MINUTES_OF_LOADING:
        assert watched.growth_mb() < 50.0
