"""The background's hold on what it has worked out."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.session.state import Session
from app.work import evaluator


class Unheard:
    """A report that nobody reads."""

    def step(self, fraction: float, text: str) -> None:
        """Do nothing."""

    def hand_over(self, part: object) -> None:
        """Do nothing."""


def test_memory_is_given_back_after_every_frame_that_is_worked_out_anew(
    touch_file: Path, monkeypatch: pytest.MonkeyPatch
):
    given_back: list[int] = []
    monkeypatch.setattr(evaluator, "release_free_memory", lambda: given_back.append(shown))
    asked = evaluator.Evaluator()
    for shown in (1, 2, 1, 2):
        asked.evaluate_frame(Session(recording=touch_file, target="gelslim", frame=shown), ("depth",), Unheard())  # pyright: ignore[reportArgumentType]
    asked.close()
    assert given_back == [1, 2]
