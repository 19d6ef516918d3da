"""Memory stays bounded: the undo stack is limited, and cached values are measured."""

from __future__ import annotations

import gc
from collections import deque

import numpy as np
from PyQt6.QtGui import QImage

from app.session.state import Session
from app.session.undo import MAX_UNDO_STEPS, SessionChange
from pipeline.core.memo import Memo
from tests.app.window.window_checks import kept_bytes, kept_bytes_of


def test_the_undo_stack_is_limited(open_window):
    stack = open_window().undo_stack
    shown = deque[Session](maxlen=1)
    session = Session()
    for frame in range(1, MAX_UNDO_STEPS + 201):
        new = Session(frame=frame)
        stack.push(SessionChange(old=session, new=new, text="go", key="", show=shown.append))
        session = new
    del new
    assert stack.count() == MAX_UNDO_STEPS
    gc.collect()
    assert sum(type(thing) is Session for thing in gc.get_objects()) < MAX_UNDO_STEPS + 50
    stack.undo()
    assert shown[0].frame == MAX_UNDO_STEPS + 199
    stack.clear()


def test_values_shared_by_caches_are_counted_once():
    whole = np.zeros((100, 1000), np.float32)
    first: Memo[str, object] = Memo()
    second: Memo[str, object] = Memo()
    third: Memo[str, object] = Memo(weigh=lambda _: 12345)
    memos = (first, second, third)
    first.put("a", (whole, whole[:10]))
    second.put("b", {"part": whole[5:6]})
    assert kept_bytes_of(memos) == whole.nbytes
    second.put("c", (QImage(100, 50, QImage.Format.Format_RGB32), (whole,)))
    assert kept_bytes_of(memos) == whole.nbytes + 4 * 100 * 50
    third.put("net", object())
    assert kept_bytes_of(memos) == whole.nbytes + 4 * 100 * 50 + 12345
    assert kept_bytes() >= kept_bytes_of(memos)
