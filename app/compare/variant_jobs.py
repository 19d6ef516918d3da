"""Variants of a session: their parameters, their differences, and the commands that make the
same comparisons.
"""

import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from app.document.requests import make_request
from app.session.layout import LAST_STAGE
from app.session.state import REQUEST_FIELDS, Session
from pipeline.core.graph import Method
from pipeline.core.params import Setting, Value, list_settings
from pipeline.lab.evaluation.grid_comparison import METHOD, WEIGHTS, GridPlan, format_value
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.reports.export_request import format_options, format_settings

_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # suggested values as multiples of the current one
# Parameters that a grid offers first.
_EFFECTIVE_PARAMETERS = (
    "guidance",
    "steps",
    "certainty",
    "pressure_share",
    "smoothing_px",
    "grazing_deg",
)


def list_axes(
    session: Session,
    methods: Sequence[Method],
    catalogue: Catalogue,
    sensor_kinds: Mapping[str, str],
) -> dict[str, str]:
    """What the axes of a grid can try -> suggested values, comma-separated.

    The most effective parameters first.

    These changed the error in contact most on touches of the sample when swept over their suggested
    values: guidance and steps if the touch is sampled; the certainty that a network's contact
    needs; the pressure share that counts as contact on a gel and the smoothing of its slopes; the
    steepest surface that the target may observe. `sensor_kinds` is method key -> kind of sensor,
    where known.
    """
    parameters = [
        (
            name,
            f"{method.stage}.{name}",
            ", ".join(map(format_value, suggest_values(value, setting))),
        )
        for method in methods
        for name, (value, setting) in list_settings(session.get_params(method)).items()
        if (not isinstance(value, str) or setting.choices)
        and setting.applies_to(sensor_kinds.get(method.key, ""))
    ]
    rank = {name: index for index, name in enumerate(_EFFECTIVE_PARAMETERS)}
    parameters.sort(key=lambda parameter: rank.get(parameter[0], len(rank)))
    axes = {title: values for _, title, values in parameters}
    for method in methods:
        kind = sensor_kinds.get(method.key, "")
        names = [m.name for m in catalogue.list_choices(method.stage) if m.fits(kind)]
        if len(names) > 1:
            axes[f"{method.stage}.{METHOD}"] = ", ".join(names)
        if method.weights is not None:
            axes[f"{method.stage}.{WEIGHTS}"] = str(session.weights.get(method.stage, ""))
    return axes


def label_axes(
    axes: Iterable[str], methods: Sequence[Method], catalogue: Catalogue
) -> dict[str, str]:
    """Return axis -> what people read: stage and parameter."""
    settings = {
        f"{method.stage}.{name}": setting
        for method in methods
        for name, (_, setting) in list_settings(method.params()).items()
    }
    words: dict[str, str] = {}
    for axis in axes:
        stage, _, name = axis.partition(".")
        what = settings[axis].label.lower() if axis in settings else name
        words[axis] = f"{catalogue.stage(stage).title}: {what}"
    return words


def suggest_values(value: Value, setting: Setting) -> tuple[Value, ...]:
    """Values to try: all of a few choices, those of the setting, or multiples of the current
    value in its limits.
    """
    if isinstance(value, bool):
        return (False, True)
    if setting.choices:
        return setting.choices
    if setting.sweep:
        return setting.sweep
    if isinstance(value, str):
        return (value,)
    base = value or setting.step or 1.0
    tried = [min(max(base * factor, setting.low), setting.high) for factor in _FACTORS]
    make = round if isinstance(value, int) else float
    return tuple(sorted({make(one) for one in (*tried, value)}))


def format_compare_command(
    session: Session, last_stage: str, target: str, out: Path, plan: GridPlan | None = None
) -> str:
    """`tactoscope compare ...` for the current tab, or for a grid.

    `last_stage` and `target` are the opened ones.
    """
    options = _list_options(session, target)
    words = ["tactoscope", "compare", *options, "--frame", str(session.frame)]
    settings = session.comparison
    if plan is not None:
        for option, axis in zip(("--across", "--down"), plan.axes, strict=False):
            words += [option, f"{axis.title}={','.join(map(_spell, axis.values))}"]
        words += ["--metric", plan.metric]
    elif settings.tab == "methods":
        words += ["--order", settings.order]
    elif session.variant is not None:
        stage = last_stage if settings.stage == LAST_STAGE else settings.stage or "all"
        other = shlex.join(_list_options(session.variant, target))
        words += ["--stage", stage, "--variant", other]
    words += list_set_options({"display": session.display})
    return shlex.join([*words, "--out", os.fspath(out.absolute())])


def list_set_options(params: Mapping[str, object]) -> list[str]:
    """List `--set NAME=VALUE` for every changed parameter."""
    return [word for line in format_settings(params) for word in ("--set", line)]


def _spell(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)  # all digits of a number


def _list_options(session: Session, target: str) -> list[str]:
    """What is open, with every changed parameter, also of methods that are not in use."""
    request = replace(
        make_request(session), offsets=session.offsets, target=session.target or target
    )
    params = {
        key: value
        for key, value in session.params.items()
        if key != "display" and list_settings(value)
    }
    return [*format_options(request), *list_set_options(params)]


_NOTHING = "nothing"  # of a stage that a route has not


def describe_differences(
    one: Session, other: Session, catalogue: Catalogue, *, has_mesh: bool = False
) -> tuple[str, ...]:
    """List as `name: one | other` everything that the results of a frame depend on and that
    differs; `has_mesh` decides the route of a session that names none.
    """
    a, b = (_list_values(session, catalogue, has_mesh=has_mesh) for session in (one, other))
    names = [
        name for name in dict.fromkeys((*a, *b)) if a.get(name, "nothing") != b.get(name, "nothing")
    ]
    texts: list[str] = []
    for name in names:
        stage, _, setting = name.partition(", ")
        if name in ("alignment offsets", "weights"):
            texts.append(f"{name} differ")
        elif not setting or stage not in names:  # those of two methods are not compared
            pair = (_format_value(of.get(name, _NOTHING)) for of in (a, b))
            texts.append(f"{name}: {' | '.join(pair)}")
    return tuple(texts)


def _list_values(session: Session, catalogue: Catalogue, *, has_mesh: bool) -> dict[str, object]:
    """What is open, the method of every stage, and its parameters."""
    values: dict[str, object] = {
        name.replace("_", " "): getattr(session, name) for name in REQUEST_FIELDS
    }
    values["alignment offsets"] = session.offsets
    route = catalogue.route(session.route, has_mesh=has_mesh)
    for method in catalogue.methods(route.name, session.methods):
        stage = catalogue.stage(method.stage).title
        values[stage] = method.title
        for value, setting in list_settings(session.get_params(method)).values():
            values[f"{stage}, {setting.label.lower()}"] = value
    return values | {"weights": session.weights}


def _format_value(value: object) -> str:
    if isinstance(value, Path):
        return value.name
    if isinstance(value, float):
        return f"{value:g}"
    return "as recorded" if value in ("", None) else str(value)
