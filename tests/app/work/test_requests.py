"""Where a failure goes back to on the undo stack."""

from __future__ import annotations

from pathlib import Path

from app.document.requests import find_undo_target, make_request_if_open
from app.session.state import Session

NOTHING, A, B, C, BAD = (
    Session(recording=Path(path) if path else None)
    for path in ("", "a.h5", "b.h5", "c.h5", "bad.h5")
)


def place(sessions, at, opened, failing=()):
    return find_undo_target(
        sessions,
        at,
        {make_request_if_open(s) for s in opened},
        {make_request_if_open(s) for s in failing},
    )


def test_the_nearest_open_session_is_the_undo_target():
    assert place([A, B, A, BAD], 3, [A]) == 2
    assert place([BAD, B, A], 0, [A]) == 2  # it was undone too far
    assert place([NOTHING, BAD], 1, [NOTHING]) == 0


def test_without_an_open_session_the_nearest_earlier_untried_one_is_the_target():
    assert place([A, B, BAD, BAD], 3, [C], [BAD]) == 1
    assert place([A, B, BAD], 2, [C], [B, BAD]) == 0
    assert place([NOTHING, B, BAD], 2, [C], [B, BAD]) is None
    assert place([], 0, [C], [BAD]) is None
