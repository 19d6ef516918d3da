"""How files know each other: imports that only types need left out, those inside functions counted."""

from __future__ import annotations

from graphlib import TopologicalSorter

import grimp


def test_no_file_is_imported_by_what_it_imports():
    graph = grimp.build_graph("pipeline", "app", "widgets", exclude_type_checking_imports=True, cache_dir=None)
    needs = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert sum(map(len, needs.values())) > len(needs)
    TopologicalSorter(needs).prepare()  # raises CycleError, which names the circle
