"""Errors that nobody caught: log, banner, and standard error."""

from __future__ import annotations

import sys

from app.window.logs import LogRelay
from pipeline.core.errors import SettingProblem


def test_an_uncaught_error_is_printed_too_and_a_mistake_of_the_user_is_not(qtbot, capsys):
    relay = LogRelay()
    shown = []
    relay.error_uncaught.connect(shown.append)
    relay.catch_uncaught()
    try:
        sys.excepthook(SettingProblem, SettingProblem("choose a sensor"), None)
        assert capsys.readouterr().err == ""
        sys.excepthook(ZeroDivisionError, ZeroDivisionError("by nothing"), None)
        assert "ZeroDivisionError: by nothing" in capsys.readouterr().err
    finally:
        relay.close()
    assert [type(error) for error in shown] == [SettingProblem, ZeroDivisionError]
