from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.memo import Memo, measure_bytes, memoise


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 120)), max_size=60), st.integers(1, 6))
def test_a_memo_never_holds_more_than_allowed_and_answers_as_if_it_held_nothing(asked, most):
    memo: Memo[int, tuple[int, int]] = Memo(most, most_bytes=200, weigh=lambda answer: answer[1])
    weights = dict(asked)  # one weight a key
    for key, _ in asked:
        assert memo.get_or_make(key, lambda key=key: (key, weights[key])) == (key, weights[key])
        assert len(memo) <= most
        assert memo.n_bytes <= 200
    memo.clear()
    assert (len(memo), memo.n_bytes) == (0, 0)


def test_the_longest_unused_answer_goes_first():
    memo: Memo[str, int] = Memo(2)
    for key, answer in (("a", 1), ("b", 2)):
        memo.put(key, answer)
    memo.get("a")
    memo.put("c", 3)
    assert (memo.get("a"), memo.get("b"), memo.get("c")) == (1, None, 3)


def test_an_answer_is_made_once_however_many_threads_ask_for_it():
    memo: Memo[int, str] = Memo(8)
    made: list[int] = []

    def make(key: int) -> str:
        made.append(key)
        time.sleep(0.01)
        return str(key)

    with ThreadPoolExecutor(8) as pool:
        keys = [0, 1, 2] * 20
        assert list(pool.map(lambda key: memo.get_or_make(key, lambda: make(key)), keys)) == [
            str(key) for key in keys
        ]
    assert sorted(made) == [0, 1, 2]


def test_a_failure_is_the_asker_s_own_and_the_next_one_makes_the_answer():
    memo: Memo[str, int] = Memo(8)
    started = threading.Event()
    waiting = threading.Event()

    def fail() -> int:
        started.set()
        waiting.wait()
        raise ValueError("not this time")

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(memo.get_or_make, "key", fail)
        started.wait()
        second = pool.submit(memo.get_or_make, "key", lambda: 7)
        waiting.set()
        with pytest.raises(ValueError, match="not this time"):
            first.result()
        assert second.result() == 7
    assert memo.get("key") == 7


def test_a_function_remembers_its_last_answers_within_their_bytes():
    asked: list[int] = []

    @memoise(4, most_bytes=1000)
    def zeros(n: int, *, like: str = "<f8"):
        asked.append(n)
        return np.zeros(n, like)

    assert zeros(100) is zeros(100)
    assert zeros(100, like="<f4").dtype == np.float32
    assert zeros(126) is not zeros(126)  # 1008 bytes
    assert asked == [100, 100, 126, 126]


def test_an_array_is_weighed_once_and_where_it_was_made():
    made = np.zeros(1000, np.float32)
    own = np.zeros(500, np.float32)
    assert measure_bytes((made, made)) == 4000
    assert measure_bytes((made, own), besides=[made]) == 2000
