"""Requests for stages: idle, draft, running, stale, without a window."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.document.requests import Requests

OPEN = Requests().request(1, 0.0, opens=True, interrupts=True).show_part("source").end()


def request(before: Requests, ticket: int, now_s: float = 10.0, draft_stage: str = "") -> Requests:
    interrupts = before.must_interrupt(now_s, opens=False)
    return before.request(
        ticket, now_s, opens=False, interrupts=interrupts, draft_stage=draft_stage
    )


def test_another_recording_shows_no_older_part():
    running = request(OPEN, 2)
    assert running.state == "running"
    assert running.accepts(1), "of the same recording: a drag shows intermediate results"
    other = running.request(3, 10.0, opens=True, interrupts=True)
    assert not other.accepts(2)
    assert other.opening == 3
    assert request(other, 4).opening == 4, "what is asked for meanwhile opens it as well"
    assert other.show_part().opening == 0


@pytest.mark.parametrize(("age_s", "interrupts"), [(0.1, False), (0.6, True)])
def test_a_young_request_finishes_and_an_older_one_is_cancelled(age_s, interrupts):
    assert request(OPEN, 2).must_interrupt(10.0 + age_s, opens=False) == interrupts
    assert request(OPEN, 2).must_interrupt(10.0 + age_s, opens=True)


def test_requests_that_wait_do_not_keep_the_first_one_running():
    waiting = request(request(OPEN, 2, now_s=10.0), 3, now_s=10.4)
    assert waiting.must_interrupt(10.6, opens=False)


def test_a_draft_is_not_cancelled_before_its_stage_is_on_screen():
    draft = request(OPEN, 2, draft_stage="depth")
    assert draft.state == "draft"
    assert not draft.must_interrupt(99.0, opens=False)
    assert draft.show_part("source").state == "draft"
    assert draft.show_part("depth").must_interrupt(99.0, opens=False)


@pytest.mark.parametrize("background", [False, True])
def test_a_short_job_leaves_dropped_stages_stale_and_no_others(background):
    assert OPEN.yield_to(2, background=background).state == "idle"
    stale = request(OPEN, 2).yield_to(3, background=background)
    assert stale.state == "stale"
    assert stale.yield_to(4, background=background).state == "stale"
    assert (stale.ticket, stale.background) == (3, 3 if background else 0)
    assert request(stale, 4).state == "running"


CHANGES = st.sampled_from(("request", "draft", "open", "yield", "part", "end", "close"))


@given(st.lists(CHANGES, max_size=30))
def test_whatever_happens_the_newest_request_is_shown_and_its_end_is_idle(changes):
    requests = Requests()
    newest = 0
    for change in changes:
        newest += change in ("request", "draft", "open", "yield")
        requests = {
            "request": request,
            "draft": lambda now, n: request(now, n, draft_stage="depth"),
            "open": lambda now, n: now.request(n, 10.0, opens=True, interrupts=True),
            "yield": lambda now, n: now.yield_to(n, background=True),
            "part": lambda now, _: now.show_part("depth"),
            "end": lambda now, _: now.end(),
            "close": lambda now, n: now.close_recording(n),
        }[change](requests, newest)
        assert requests.accepts(newest + 1)
        assert not requests.is_running or requests.accepts(requests.ticket)
        assert requests.end().state == "idle"
