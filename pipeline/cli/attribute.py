"""`tactoscope blame`: which slot the error of each frame comes from."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pipeline.base.errors import SettingProblem
from pipeline.base.files import write_json
from pipeline.base.frame_lists import parse_frames
from pipeline.cli.interrupts import interruptible_progress
from pipeline.cli.terminal import print_line
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph
from pipeline.translation.catalogue import with_settings
from pipeline.translation.error_attribution import ErrorAttribution, attribute_error
from pipeline.translation.translate import Request, open_translation

_CACHE_BYTES = 64 * 1024 * 1024  # one frame's slots, those with truth in their place beside those without


def print_attribution(
    request: Request, figure: str, frame: int | None, settings: Sequence[str], json: Path | None
) -> int:
    """Print every frame's error as a sum, worst frame first, and the median of each part; returns the exit code."""
    translation = open_translation(request)
    try:
        params = with_settings(translation.methods, settings)
        indices = parse_frames("", translation.n_frames) if frame is None else [translation.check_index(frame)]
        graph = translation.build_graph(like=Graph((), cache=Cache(_CACHE_BYTES)))
        with Console(stderr=True).status("") as status, interruptible_progress() as work:
            found: list[ErrorAttribution] = []
            for index in indices:
                status.update(f"frame {index} of {translation.n_frames}")
                one = attribute_error(translation, graph, params, index, figure, work)
                if one is not None:
                    found.append(one)
    finally:
        translation.recording.close()
    if not found:
        raise SettingProblem(
            f"{figure} is known of none of these frames; it takes a recording that holds what "
            f"{translation.target.name} really felt of the same touches"
        )
    found.sort(key=lambda one: one.total, reverse=True)
    _print(found)
    if json is not None:
        write_json(json, [asdict(one) for one in found])
    return 0


def _print(found: Sequence[ErrorAttribution]) -> None:
    titles = list(dict.fromkeys(part.title for one in found for part in one.shares))
    unit = found[0].unit
    table = Table("frame", f"{found[0].metric}, {unit}", *titles, "the rest")
    shares = [{part.title: part.share for part in one.shares} for one in found]
    for one, by in zip(found, shares, strict=True):
        cells = (f"{by[title]:+.3f}" if title in by else "" for title in titles)
        table.add_row(str(one.frame), f"{one.total:.3f}", *cells, f"{one.remainder:+.3f}")
    if len(found) > 1:
        middle = (statistics.median(by[t] for by in shares if t in by) for t in titles)
        rest = statistics.median(one.remainder for one in found)
        total = statistics.median(one.total for one in found)
        table.add_row("median", f"{total:.3f}", *(f"{m:+.3f}" for m in middle), f"{rest:+.3f}", style="bold")
    Console().print(table)
    print_line(f"frame {found[0].frame} is the worst: {found[0].summary}")
