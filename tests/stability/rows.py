"""Rows of the stability matrix: how many cases each takes, and what became of them."""

from __future__ import annotations

import functools
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from hypothesis import HealthCheck, Phase, settings

SHORT = 24  # cases a row in the short form: all of the folder within 40 s on two cores
FEWEST = 3


@dataclass(slots=True)
class Tally:
    """One row of the table."""

    number: str  # in the list of tests/stability/__init__.py
    row: str
    cases: int = 0
    failures: int = 0  # failing calls, those of the search for the smallest example included
    asked: int = 0  # calls that may be answered by a sentence in the place of a result
    refused: int = 0  # of these, so answered
    slowest_ms: float = 0.0
    seconds: float = 0.0


@dataclass(slots=True)
class Size:
    """How much is asked for; set once, before any test module is read."""

    cases: int = SHORT
    long: bool = False


SIZE = Size()
TALLIES: dict[str, Tally] = {}
_RUNNING: list[Tally] = []  # the row whose case is being checked


def cases(share: float) -> int:
    """Cases of a row that takes this share of the number asked for."""
    return max(FEWEST, round(SIZE.cases * share))


def count_answer(*, refused: bool) -> None:
    """Count one answer, or one refusal, for the row that is running.

    Of no effect outside of a row.
    """
    if _RUNNING:
        _RUNNING[-1].asked += 1
        _RUNNING[-1].refused += refused


def row(number: int | str, name: str, *, share: float = 1.0, refused: float = 0.0):
    """Count a test's cases under this name.

    With `@given` below it, draw as many as the size asks for.

    A row whose answers are sentences instead of results in more than the share `refused` of its
    calls fails: a stage that refused everything would break no other promise.
    """

    def counted(test):
        tally = TALLIES.setdefault(name, Tally(number=str(number), row=name))
        given = getattr(test, "hypothesis", None)
        if given is None:
            return _bounded(_counting(test, tally), tally, refused)
        given.inner_test = _counting(given.inner_test, tally)
        # Building a scene may take longer than the check, and a slow failing case is not worth a
        # search for a smaller.
        phases = [Phase.explicit, Phase.reuse, Phase.generate]
        drawn = settings(
            max_examples=cases(share),
            suppress_health_check=list(HealthCheck),
            phases=phases if SIZE.long or share < 1.0 else [*phases, Phase.shrink],
            report_multiple_bugs=False,
        )(test)
        return _bounded(drawn, tally, refused)

    return counted


def _bounded(test, tally: Tally, refused: float):
    @functools.wraps(test)
    def run(*args, **kwargs):
        answer = test(*args, **kwargs)
        # Few cases scatter about their share by its standard deviation; four of them come by chance
        # in no lifetime.
        most = refused * tally.asked + 4 * (refused * (1 - refused) * tally.asked) ** 0.5
        assert tally.refused <= most, (
            f"{tally.refused} of {tally.asked} were refused, where {refused:.0%} are usual"
        )
        return answer

    return run


def _counting(test, tally: Tally):
    @functools.wraps(test)
    def run(*args, **kwargs):
        began = time.perf_counter()
        tally.cases += 1
        _RUNNING.append(tally)
        try:
            return test(*args, **kwargs)
        except AssertionError:
            tally.failures += 1
            raise
        except BaseException as error:  # pytest's failures are no Exception
            # Hypothesis leaves a case by exceptions of its own, which are no failures.
            tally.failures += not type(error).__module__.startswith("hypothesis")
            raise
        finally:
            _RUNNING.pop()
            spent = time.perf_counter() - began
            tally.seconds += spent
            tally.slowest_ms = max(tally.slowest_ms, 1e3 * spent)

    return run


def table() -> list[str]:
    """The rows that ran, as lines of text."""
    done = [t for t in TALLIES.values() if t.cases]
    lines = [
        f"{'no.':<5}{'row':<84}{'cases':>7}{'failures':>10}{'refused':>9}{'slowest':>12}{'all':>9}"
    ]
    for t in sorted(done, key=lambda t: (float(t.number.split(",")[0]), t.row)):
        lines.append(
            f"{t.number:<5}{t.row:<84}{t.cases:>7}{t.failures:>10}{_share(t):>9}{t.slowest_ms:>9.1f} ms{t.seconds:>7.1f} s"
        )
    total = sum(t.cases for t in done)
    failed = sum(t.failures for t in done)
    return [
        *lines,
        f"{'':<5}{f'{len(done)} rows':<84}{total:>7}{failed:>10}{'':>21}{sum(t.seconds for t in done):>7.1f} s",
    ]


def _share(t: Tally) -> str:
    return f"{t.refused / t.asked:.1%}" if t.asked else "-"


def write(path: Path) -> None:
    """The table as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    report = {
        "cases_asked_for": SIZE.cases,
        "rows": [asdict(t) for t in TALLIES.values() if t.cases],
    }
    path.write_text(json.dumps(report, indent=1) + "\n")
