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
from pipeline.base.params import changed
from pipeline.base.progress import Progress
from pipeline.cli.opening_options import NOTHING_ELSE, Opening
from pipeline.cli.stopping import stoppable
from pipeline.cli.terminal import print_line
from pipeline.engine.graph import Graph
from pipeline.evaluation.metrics import METRICS
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.tiles import Tile
from pipeline.scoring.by_seed import by_seed
from pipeline.scoring.side_by_side import by_method
from pipeline.scoring.tiles import Tiles, write_tiles
from pipeline.scoring.two_at_once import side_of, tiles_of
from pipeline.scoring.two_parameters import Axis, Plan, axis, swept
from pipeline.scoring.two_parameters import tiles_of as pairs_as_tiles
from pipeline.scoring.versions import Kept
from pipeline.translation.blame import FIGURE
from pipeline.translation.catalogue import BUILT_IN
from pipeline.translation.translate import Request, Translation, open_translation

_DISPLAY = "display"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What is compared: with `beside` two at once, with `seeds` as many of them, else every method."""

    frame: int
    order: str
    seeds: int
    slot: str  # "" = all
    beside: str
    across: str = ""  # "slot.parameter=value,value", with `down` another: every pair of their values
    down: str = ""
    figure: str = ""  # that judges them


@dataclass(frozen=True, slots=True, kw_only=True)
class _Other:
    """The words of the other: what it opens, and how."""

    recording: Path | None
    target: str
    opening: Opening
    settings: tuple[str, ...]


def write_comparison(
    recording: Path, target: str, opening: Opening, settings: Sequence[str], wanted: Wanted, out: Path
) -> int:
    """Write one comparison's pictures and figures, and print the figures; returns 0."""
    with _opened(opening.request(recording, target)) as one, stoppable() as work:
        one.checked(wanted.frame)
        given, display = _params(one, settings)
        if wanted.across or wanted.down:
            shown = _pairs(one, given, display, wanted, work)
        elif wanted.beside:
            other = _other(wanted.beside)
            if other.recording is None:
                other = _in_place(other, recording, opening, settings)
            shown = _two(one, given, display, other, other.target or target, wanted, work)
        elif wanted.seeds:
            shown = by_seed(one, wanted.frame, given, display, wanted.seeds, progress=work)
        else:
            shown = by_method(one, wanted.frame, given, display, wanted.order, Kept(), progress=work)
    write_tiles(out, shown.tiles)
    _print(shown.tiles)
    print_line(f"{shown.told.replace(' (now)', '').replace(' (held)', '')}; written to {os.fspath(out)}")
    return 0


def _two(
    one: Translation, given: Mapping[str, object], display: DisplayParams, other: _Other, target: str, wanted: Wanted,
    work: Progress,
) -> Tiles:  # fmt: skip
    assert other.recording is not None
    a = side_of("A", one, wanted.frame, given, display, wanted.slot, Graph(one.methods), work)
    with _opened(other.opening.request(other.recording, target)) as translation:
        params, _ = _params(translation, other.settings)
        graph = Graph(translation.methods)
        b = side_of("B", translation, wanted.frame, params, display, wanted.slot, graph, work)
        return tiles_of(a, b, wanted.slot, wanted.beside)


def _pairs(
    one: Translation, given: Mapping[str, object], display: DisplayParams, wanted: Wanted, work: Progress
) -> Tiles:
    """Every pair of values of two parameters; raises SettingProblem."""
    plan = Plan(across=_axis(one, given, wanted.across), down=_axis(one, given, wanted.down), figure=wanted.figure)
    slot, _, name = wanted.figure.partition(".")
    if wanted.figure and (name not in METRICS or slot not in one.slots):
        raise SettingProblem(f"no figure {wanted.figure!r} on this route; give one such as {FIGURE}")
    cells = swept(one, wanted.frame, given, display, plan, progress=work)
    told = f"frame {wanted.frame}: {plan.across.called} by {plan.down.called}, {len(cells)} pairs"
    return Tiles(tiles=pairs_as_tiles(plan, cells), told=told)


def _axis(one: Translation, given: Mapping[str, object], words: str) -> Axis:
    called, equals, values = words.partition("=")
    slot, dot, name = called.strip().partition(".")
    method = next((method for method in one.methods if method.slot == slot), None)
    if not (equals and dot and method):
        raise SettingProblem(f"--across and --down both name slot.parameter=value,value of this route, got {words!r}")
    return axis(given.get(method.key, method.params()), method, name, values)


def _params(translation: Translation, settings: Sequence[str]) -> tuple[dict[str, object], DisplayParams]:
    """Parameters by key of a method, and how things are drawn; raises SettingProblem."""
    given: dict[str, object] = {}
    display = DisplayParams()
    of_slot = {method.slot: method for method in translation.methods}
    for line in settings:
        name, equals, value = (part.strip() for part in line.partition("="))
        key, _, parameter = name.rpartition(".")
        if not equals or not key:
            raise SettingProblem(f"a parameter is set by slot.parameter=value, got {line!r}")
        if key == _DISPLAY:
            display = changed(display, parameter, value)
            continue
        slot, slash, called = key.partition("/")
        method = BUILT_IN.method(slot, called) if slash else of_slot.get(slot)
        if method is None:
            raise SettingProblem(f"no slot {slot!r} on this route; there are {', '.join(of_slot)}")
        given[method.key] = changed(given.get(method.key, method.params()), parameter, value)
    return given, display


def _other(words: str) -> _Other:
    """The other's options; raises SettingProblem."""

    def read(
        recording: Path | None = None,
        *,
        target: str = "",
        opening: Opening = NOTHING_ELSE,
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


def _in_place(other: _Other, recording: Path, opening: Opening, settings: Sequence[str]) -> _Other:
    """This one, with the other's options in place of its own."""
    said = {field.name: getattr(other.opening, field.name) for field in fields(Opening)}
    said = {name: value for name, value in said.items() if value != getattr(NOTHING_ELSE, name)}
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
    names = list(dict.fromkeys(name for tile in tiles for name in tile.figures))
    table = Table("", *names, "")
    for tile in tiles:
        table.add_row(tile.title, *(f"{tile.figures[n]:.4g}" if n in tile.figures else "" for n in names), tile.problem)
    Console().print(table)
