"""The background's hold on what it has worked out."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.document import evaluator
from app.session.state import Session
from pipeline.views.display_params import DisplayParams


class SilentReporter:
    """A reporter that drops everything."""

    def step(self, fraction: float, text: str) -> None:
        """Do nothing."""

    def deliver(self, part: object) -> None:
        """Do nothing."""


def test_memory_is_released_after_every_computed_frame(
    touch_file: Path, monkeypatch: pytest.MonkeyPatch
):
    released: list[int] = []
    monkeypatch.setattr(evaluator, "release_free_memory", lambda: released.append(shown))
    asked = evaluator.Evaluator()
    # limits that are set: fitting them computes the frame with the strongest touch
    display = DisplayParams(gel_limit_mm=1.0, bubble_limit_mm=5.0)
    for shown in (1, 2, 1, 2):
        asked.evaluate_frame(
            Session(recording=touch_file, target="gelslim", frame=shown).with_display(display),
            ("depth",),
            SilentReporter(),
        )  # pyright: ignore[reportArgumentType]
    asked.close()
    assert released == [1, 2]
