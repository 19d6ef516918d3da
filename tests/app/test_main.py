"""How the window starts."""

from __future__ import annotations

from app.frame.tour import wait_until_shown
from app.session.sample import SAMPLE
from app.session.state import ON_A_TOUCH


def test_a_recording_opens_on_a_touched_frame_whatever_comes_first(open_window, touch_file):
    """The sample begins untouched; so does what is opened later."""
    instrument = open_window(SAMPLE, frame=ON_A_TOUCH)
    assert wait_until_shown(instrument, 60), instrument.window.banner.text
    assert instrument.latest.results["depth"].output.contact.any()
    assert instrument.window.timeline.frame == instrument.session.frame == instrument.latest.index > 0
    instrument.open_path(touch_file)
    assert wait_until_shown(instrument, 60), instrument.window.banner.text
    assert instrument.session.frame == 2  # pressed deepest
    assert instrument.latest.results["depth"].output.contact.any()
