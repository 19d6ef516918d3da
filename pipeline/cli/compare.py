"""Working out what `tactoscope compare` asks for."""

from __future__ import annotations

import contextlib
import os
import shlex
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter
from rich.console import Console
from rich.table import Table

from pipeline.base.errors import SettingProblem
from pipeline.base.params import replace_value
from pipeline.base.progress import Progress
from pipeline.cli.interrupts import interruptible_progress
from pipeline.cli.terminal import print_line
from pipeline.cli.translation_options import DEFAULT_OPTIONS, TranslationOptions
from pipeline.engine.graph import Graph
from pipeline.evaluation.comparison_tiles import ComparisonTiles, write_tiles
from pipeline.evaluation.method_comparison import compare_methods
from pipeline.evaluation.method_results import MethodCache
from pipeline.evaluation.parameter_sweep import SweepAxis, SweepPlan, parse_axis, sweep_grid
from pipeline.evaluation.parameter_sweep import build_tiles as pairs_as_tiles
from pipeline.evaluation.seed_sweep import sweep_seeds
from pipeline.evaluation.variant_comparison import build_tiles, evaluate_variant
from pipeline.metrics.stage_metrics import METRICS
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.tile import Tile
from pipeline.translation.catalogue import BUILT_IN
from pipeline.translation.error_attribution import DEFAULT_METRIC
from pipeline.translation.translate import Request, Translation, open_translation

_DISPLAY = "display"


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRequest:
    """What is compared: with `beside` two at once, with `seeds` as many of them, else every method."""

    frame: int
    order: str
    seeds: int
    stage: str  # "" = all
    variant: str
    across: str = ""  # "slot.parameter=value,value", with `down` another: every pair of their values
    down: str = ""
    metric: str = ""  # that judges them


@dataclass(frozen=True, slots=True, kw_only=True)
class _Other:
    """The words of the other: what it opens, and how."""

    recording: Path | None
    target: str
    opening: TranslationOptions
    settings: tuple[str, ...]


def write_comparison(
    recording: Path,
    target: str,
    opening: TranslationOptions,
    settings: Sequence[str],
    wanted: ComparisonRequest,
    out: Path,
) -> int:
    """Write one comparison's pictures and figures, and print the figures; returns 0."""
    with _opened(opening.build_request(recording, target)) as one, interruptible_progress() as work:
        one.check_index(wanted.frame)
        given, display = _params(one, settings)
        if wanted.across or wanted.down:
            shown = _pairs(one, given, display, wanted, work)
        elif wanted.variant:
            other = _other(wanted.variant)
            if other.recording is None:
                other = _in_place(other, recording, opening, settings)
            shown = _two(one, given, display, other, other.target or target, wanted, work)
        elif wanted.seeds:
            shown = sweep_seeds(one, wanted.frame, given, display, wanted.seeds, progress=work)
        else:
            shown = compare_methods(one, wanted.frame, given, display, wanted.order, MethodCache(), progress=work)
    write_tiles(out, shown.tiles)
    _print(shown.tiles)
    print_line(f"{shown.summary.replace(' (now)', '').replace(' (held)', '')}; written to {os.fspath(out)}")
    return 0


def _two(
    one: Translation, given: Mapping[str, object], display: DisplayParams, other: _Other, target: str, wanted: ComparisonRequest,
    work: Progress,
) -> ComparisonTiles:  # fmt: skip
    assert other.recording is not None
    a = evaluate_variant("A", one, wanted.frame, given, display, wanted.stage, Graph(one.methods), work)
    with _opened(other.opening.build_request(other.recording, target)) as translation:
        params, _ = _params(translation, other.settings)
        graph = Graph(translation.methods)
        b = evaluate_variant("B", translation, wanted.frame, params, display, wanted.stage, graph, work)
        return build_tiles(a, b, wanted.stage, wanted.variant)


def _pairs(
    one: Translation, given: Mapping[str, object], display: DisplayParams, wanted: ComparisonRequest, work: Progress
) -> ComparisonTiles:
    """Every pair of values of two parameters; raises SettingProblem."""
    plan = SweepPlan(across=_axis(one, given, wanted.across), down=_axis(one, given, wanted.down), metric=wanted.metric)
    slot, _, name = wanted.metric.partition(".")
    if wanted.metric and (name not in METRICS or slot not in one.stages):
        raise SettingProblem(f"no figure {wanted.metric!r} on this route; give one such as {DEFAULT_METRIC}")
    cells = sweep_grid(one, wanted.frame, given, display, plan, progress=work)
    told = f"frame {wanted.frame}: {plan.across.qualified_name} by {plan.down.qualified_name}, {len(cells)} pairs"
    return ComparisonTiles(tiles=pairs_as_tiles(plan, cells), summary=told)


def _axis(one: Translation, given: Mapping[str, object], words: str) -> SweepAxis:
    called, equals, values = words.partition("=")
    slot, dot, name = called.strip().partition(".")
    method = next((method for method in one.methods if method.stage == slot), None)
    if not (equals and dot and method):
        raise SettingProblem(f"--across and --down both name slot.parameter=value,value of this route, got {words!r}")
    return parse_axis(given.get(method.key, method.params()), method, name, values)


def _params(translation: Translation, settings: Sequence[str]) -> tuple[dict[str, object], DisplayParams]:
    """Parameters by key of a method, and how things are drawn; raises SettingProblem."""
    given: dict[str, object] = {}
    display = DisplayParams()
    of_slot = {method.stage: method for method in translation.methods}
    for line in settings:
        name, equals, value = (part.strip() for part in line.partition("="))
        key, _, parameter = name.rpartition(".")
        if not equals or not key:
            raise SettingProblem(f"a parameter is set by slot.parameter=value, got {line!r}")
        if key == _DISPLAY:
            display = replace_value(display, parameter, value)
            continue
        slot, slash, called = key.partition("/")
        method = BUILT_IN.method(slot, called) if slash else of_slot.get(slot)
        if method is None:
            raise SettingProblem(f"no slot {slot!r} on this route; there are {', '.join(of_slot)}")
        given[method.key] = replace_value(given.get(method.key, method.params()), parameter, value)
    return given, display


def _other(words: str) -> _Other:
    """The other's options; raises SettingProblem."""

    def read(
        recording: Path | None = None,
        *,
        target: str = "",
        opening: TranslationOptions = DEFAULT_OPTIONS,
        settings: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    ) -> _Other:
        return _Other(recording=recording, target=target, opening=opening, settings=settings)

    app = App(name="--beside", help_flags=[], version_flags=[])
    app.default(read)
    try:
        command, bound, _ = app.parse_args(shlex.split(words), print_error=False, exit_on_error=False)
    except (CycloptsError, ValueError) as error:
        raise SettingProblem(f"--beside takes options of this command; {error}") from error
    return command(*bound.args, **bound.kwargs)


def _in_place(other: _Other, recording: Path, opening: TranslationOptions, settings: Sequence[str]) -> _Other:
    """This one, with the other's options in place of its own."""
    said = {field.name: getattr(other.opening, field.name) for field in fields(TranslationOptions)}
    said = {name: value for name, value in said.items() if value != getattr(DEFAULT_OPTIONS, name)}
    said["methods"] = (*opening.methods, *other.opening.methods)
    return replace(
        other, recording=recording, opening=replace(opening, **said), settings=(*settings, *other.settings)
    )  # fmt: skip


@contextlib.contextmanager
def _opened(request: Request) -> Generator[Translation]:
    translation = open_translation(request)
    try:
        yield translation
    finally:
        translation.close()


def _print(tiles: Sequence[Tile]) -> None:
    names = list(dict.fromkeys(name for tile in tiles for name in tile.metrics))
    table = Table("", *names, "")
    for tile in tiles:
        table.add_row(tile.title, *(f"{tile.metrics[n]:.4g}" if n in tile.metrics else "" for n in names), tile.problem)
    Console().print(table)
