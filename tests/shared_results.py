"""Stage results that tests share: what one has computed, the next one gets as if it was computed.

Methods are pure, so that tests see what they would see without it, only sooner. A method that a
test brings itself has another function and is run; so is a key that another setting or input makes.
"""

from __future__ import annotations

import threading

import pytest

from pipeline.core import graph
from pipeline.core.graph import Graph
from pipeline.core.memo import CacheEntry, Memo

SHARED: Memo[object, CacheEntry] = Memo(most_bytes=256 << 20, weigh=lambda entry: entry.n_bytes)


def share_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every graph of this process look up what another one has computed."""
    evaluate = Graph._evaluate_method
    run = Graph._run_method
    asked = threading.local()

    def evaluate_method(self, method, values, digests, params, *more):
        reads = [digests.get(name, "") for name in method.reads]
        asked.key = method.run, graph._key(method, params, reads)
        return evaluate(self, method, values, digests, params, *more)

    def run_method(self, *given):
        key = asked.key
        entry = SHARED.get(key)
        if entry is None:
            entry = run(self, *given)
            SHARED.put(key, entry)
        return entry

    monkeypatch.setattr(Graph, "_evaluate_method", evaluate_method)
    monkeypatch.setattr(Graph, "_run_method", run_method)
