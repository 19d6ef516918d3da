"""A window with a custom stage, method and route."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.main import show_window
from app.session.state import Session, load_session, save_session
from app.shell.tour import wait_until_shown
from tests.pipeline.translation.toys import TOYS

LIMIT_S = 240
SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"


@pytest.fixture
def toys(qapp):
    session = Session(recording=SAMPLE, source="digit", target="gelslim", frame=5, route="toy")
    made = show_window(session, with_scene=False, catalogue=TOYS)
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    yield made
    made.window.close()
    made.close()


def shown(window) -> list[str]:
    cards = window.look.filmstrip.thumbnails
    return [name for name, card in cards.items() if not card.isHidden()]


def test_the_window_shows_a_custom_route(toys):
    window = toys.window
    assert shown(window) == ["source", "brightness", "touch", "touch_depth", "pose"]
    assert np.ptp(window.columns["brightness"].view.preview.pixels) > 0
    assert window.columns["brightness"].view.preview.caption == "toy brightness"
    window.inspector.all_button.setChecked(True)
    assert window.parameters.findChild(object, "touch/melt.gain").isVisibleTo(window.parameters)
    assert [window.route.itemData(i) for i in range(window.route.count())] == [
        "t2d2",
        "t2t",
        "object",
        "toy",
    ]
    toys.change("choose route", route="t2d2")
    assert wait_until_shown(toys, LIMIT_S)
    assert shown(window) == [
        "source",
        "depth",
        "cloud",
        "target_depth",
        "touch",
        "touch_depth",
        "pose",
    ]


def test_a_method_choice_is_undoable_and_saved(toys, tmp_path):
    window = toys.window
    toys.change("choose route", route="t2d2")
    box = window.columns["touch_depth"]._method
    assert [box.itemData(i) for i in range(box.count())] == ["membrane", "from_image", "truth"]
    box.setCurrentIndex(1)
    box.activated.emit(1)
    assert wait_until_shown(toys, LIMIT_S)
    assert toys.latest_frame.results["touch_depth"].method.name == "from_image"
    assert toys.session.methods == {"touch_depth": "from_image"}
    save_session(toys.session, tmp_path / "a.touch.json")
    assert load_session(tmp_path / "a.touch.json", TOYS).methods == {"touch_depth": "from_image"}
    toys.undo_stack.undo()
    assert wait_until_shown(toys, LIMIT_S)
    assert toys.latest_frame.results["touch_depth"].method.name == "membrane"
    assert box.currentData() == "membrane"
