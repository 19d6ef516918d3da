"""Two parameters tried against each other on one frame: the error and the time of every pair of values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import product

from app.session.state import Session
from app.work.jobs import Report
from app.work.opening import request_of
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.params import Setting, Value, changed, settings
from pipeline.base.progress import Share
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, Method, StageResult
from pipeline.pictures.picture import Picture
from pipeline.stages.slot import Seen
from pipeline.translation.translate import Translation, open_translation

_CACHE_BYTES = 64 * 1024 * 1024  # what does not depend on the two parameters is worked out once
_USUAL = (0.25, 0.5, 1.0, 2.0, 4.0)  # times the present value
_MOST_VALUES = 12
_MATTERS = "guidance", "steps", "certainty", "pressure_share", "smoothing_px", "grazing_deg"  # most first

Offer = tuple[str, str, str, Value, Setting]  # method's key, parameter, words, value, how it is set


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One parameter of a method and the values to try."""

    key: str  # of the method, "slot/name"
    name: str
    values: tuple[Value, ...]

    def put(self, session: Session, method: Method, value: Value) -> Session:
        """The session with this value."""
        params = changed(session.params_of(method), self.name, value)
        return replace(session, params={**session.params, self.key: params})


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What is swept: columns over rows, and the figure that judges."""

    across: Axis
    down: Axis
    figure: str  # "slot.name"; "" = only time

    @property
    def order(self) -> tuple[tuple[int, int], ...]:
        """(row, col) of all cells, corners first, so that one may stop early."""
        rows, cols = len(self.down.values), len(self.across.values)
        cells = list(product(range(rows), range(cols)))
        corners = {(r, c) for r in (0, rows - 1) for c in (0, cols - 1)}
        return tuple(sorted(cells, key=lambda cell: (cell not in corners, cell)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One pair of values, tried."""

    row: int
    col: int
    error: float  # NaN = not known of this frame
    ms: float  # of all that the slot rests on, worked out afresh
    picture: Picture | None
    problem: str = ""


def offered(session: Session, methods: Sequence[Method]) -> list[Offer]:
    """All that can be swept."""
    return [
        (method.key, name, f"{method.slot}.{name}", value, told)
        for method in methods
        for name, (value, told) in settings(session.params_of(method)).items()
        if not isinstance(value, str) or told.choices
    ]


def first_two(offers: Sequence[Offer]) -> tuple[int, int]:
    """Which of what is offered a sweep begins with: guidance and steps where the touch is sampled.

    Else what moved the error in contact most on touches of the sample, each parameter swept over its usual values: of
    a network's depth how certain its contact must be, of a gel's which share of the pressure counts as contact and how
    much its slopes are smoothed, then how steep a surface the target may see; else the first numbers.
    """
    wanted = [i for word in _MATTERS for i, offer in enumerate(offers) if offer[1] == word]
    numbers = [i for i, offer in enumerate(offers) if isinstance(offer[3], (int, float)) and i not in wanted]
    ranked = [*wanted, *numbers]
    return (ranked[0], ranked[1]) if len(ranked) > 1 else (0, 0)


def method_of(methods: Sequence[Method], key: str) -> Method:
    """The method that is swept; raises SettingProblem where another fills its slot by now."""
    found = next((method for method in methods if method.key == key), None)
    if found is None:
        slot, _, name = key.partition("/")
        raise SettingProblem(f"{slot} is not filled by {name!r} for this source; choose the parameters to sweep again")
    return found


def usual_values(value: Value, told: Setting) -> tuple[Value, ...]:
    """What to try where nobody says: all of a few, else around the present value within its limits."""
    if isinstance(value, bool):
        return (False, True)
    if told.choices:
        return told.choices
    if isinstance(value, str):
        return (value,)
    base = value or (told.step or 1.0)
    tried = sorted({min(max(base * times, told.low), told.high) for times in _USUAL} | {float(value)})
    return tuple(dict.fromkeys(round(v) for v in tried)) if isinstance(value, int) else tuple(tried)


def axis(session: Session, method: Method, name: str, words: str) -> Axis:
    """The values that somebody typed, commas between them; raises SettingProblem with what is wrong."""
    parts = [part.strip() for part in words.split(",") if part.strip()]
    if not 1 <= len(parts) <= _MOST_VALUES:
        raise SettingProblem(f"give one to {_MOST_VALUES} values of {name}, with commas between them")
    params = session.params_of(method)
    values = [settings(changed(params, name, part))[name][0] for part in parts]
    return Axis(key=method.key, name=name, values=tuple(dict.fromkeys(values)))


def swept(session: Session, plan: Plan, report: Report) -> int:
    """Work the cells out one by one, handing each over; how many there were. Raises TouchError, Cancelled."""
    with closing(open_translation(request_of(session))) as opened:
        translation = replace(opened, alignment=session.offsets.applied(opened.alignment))
        index = min(max(0, session.frame), translation.n_frames - 1)
        graph = translation.graph(like=Graph((), cache=Cache(_CACHE_BYTES)))
        times: dict[tuple[str, str], float] = {}
        across, down = (method_of(translation.methods, axis.key) for axis in (plan.across, plan.down))
        order = plan.order
        for n, (row, col) in enumerate(order):
            now = plan.across.put(session, across, plan.across.values[col])
            now = plan.down.put(now, down, plan.down.values[row])
            part = Share(report, n / len(order), 1.0 / len(order), f"{n + 1} of {len(order)}")
            report.hand_over(_cell(translation, graph, now, plan.figure, index, (row, col), times, part))
    return len(order)


def _cell(
    translation: Translation, graph: Graph, session: Session, figure: str, index: int, place: tuple[int, int],
    times: dict[tuple[str, str], float], progress: Share,
) -> Cell:  # fmt: skip
    row, col = place
    last = figure.partition(".")[0] if figure else _last_but_pose(translation)
    try:
        params = session.params_for(translation.methods)
        results = graph.evaluate([last], translation.inputs(index), params, progress)
        error = translation.metrics(results, index).get(figure, math.nan)
    except TouchError as problem:
        return Cell(row=row, col=col, error=math.nan, ms=math.nan, picture=None, problem=str(problem))
    for name, result in results.items():
        if result.state == "computed":
            times[(name, result.digest)] = result.ms
    ms = sum(times.get((name, result.digest), result.ms) for name, result in results.items())
    return Cell(row=row, col=col, error=error, ms=ms, picture=_picture(translation, session, results, last))


def _last_but_pose(translation: Translation) -> str:
    return next(name for name in reversed(translation.slots) if name != "pose")


def _picture(translation: Translation, session: Session, results: dict[str, StageResult], last: str) -> Picture:
    seen = Seen(
        outputs={name: r.output for name, r in results.items()}, source=translation.source,
        target=translation.target, mesh=translation.mesh, display=session.display,
    )  # fmt: skip
    return translation.catalogue.slot(last).picture(results[last].output, seen)
