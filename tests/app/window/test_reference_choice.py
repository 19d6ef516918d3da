"""The Reference menu: the reference comes from the recording's own frames, from a file, or as
recorded.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from app.document.requests import make_request
from app.session.sample import SAMPLE_RECORDING
from app.session.state import load_session, save_session
from app.shell.tour import wait_until_shown
from pipeline.io import open_recording
from pipeline.translation.reports.export_request import format_options

LIMIT_S = 240


def get_reference(controller):
    return controller.views.translation.stream.frame(0).reference


def get_marked(controller):
    menu = controller.window.menus["Reference"]
    return [action.text() for action in menu.actions() if action.isChecked()]


@pytest.fixture
def single_touch(tmp_path):
    """One image of a gel, which has no reference."""
    frame = open_recording(SAMPLE_RECORDING).stream("gelslim").frame(3)
    assert cv2.imwrite(str(tmp_path / "gelslim_touch.png"), frame.image[..., ::-1])
    return tmp_path / "gelslim_touch.png", frame


def test_this_frame_becomes_the_reference_and_undo_returns_to_the_recorded_one(
    bubble_window, tmp_path
):
    recorded = get_reference(bubble_window)
    index = bubble_window.session.frame
    image = bubble_window.views.translation.stream.frame(index).image
    actions = bubble_window.window.actions_by_name
    assert get_marked(bubble_window) == ["As recorded"]
    actions["reference_frame"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S), bubble_window.window.banner.text
    assert get_marked(bubble_window) == ["This frame"]
    assert np.array_equal(get_reference(bubble_window), image, equal_nan=True)
    assert (
        f"frame {index} is the reference, as chosen"
        in bubble_window.views.translation.recording.notes
    )
    assert f"--reference-frames {index}" in " ".join(
        format_options(make_request(bubble_window.session))
    )

    saved = tmp_path / "s.touch.json"
    save_session(bubble_window.session, saved)
    assert load_session(saved).reference_frames == str(index)

    actions["reference_median"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S), bubble_window.window.banner.text
    assert get_marked(bubble_window) == ["Median of this recording"]
    actions["reference_recorded"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert np.array_equal(get_reference(bubble_window), recorded, equal_nan=True)
    for marked in ("Median of this recording", "This frame", "As recorded"):
        actions["undo"].trigger()
        assert wait_until_shown(bubble_window, LIMIT_S)
        assert get_marked(bubble_window) == [marked]
    assert np.array_equal(get_reference(bubble_window), recorded, equal_nan=True)


def test_untouched_frames_are_offered_for_images_alone(bubble_window):
    offered = bubble_window.window.actions_by_name["reference_untouched"]
    assert not offered.isVisible(), "the source is a bubble"
    bubble_window.change("choose source", source="", stream="")
    bubble_window.open_path(SAMPLE_RECORDING)
    assert wait_until_shown(bubble_window, LIMIT_S), bubble_window.window.banner.text
    assert offered.isVisible() == (bubble_window.views.translation.source.kind == "gel")


def test_a_frame_without_reference_offers_the_same_choices(open_window, single_touch):
    path, _ = single_touch
    controller = open_window(path, source="gelslim", target="soft_bubble")
    assert not wait_until_shown(controller, LIMIT_S)
    (button,) = [b for b in controller.window.banner.buttons if b.text() == "Choose reference…"]
    choices = {action.text(): action for action in button.menu().actions()}
    assert list(choices) == [
        action.text() for action in controller.window.menus["Reference"].actions()
    ]
    choices["This frame"].trigger()
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert controller.session.reference_frames == "0"
