"""Variants of a session: their parameters, their differences, and the commands that make the
same comparisons.
"""

import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from app.document.evaluator import Evaluator
from app.document.requests import make_request
from app.session.layout import LAST_STAGE
from app.session.state import REQUEST_FIELDS, Session
from app.window.jobs import JobReporter
from pipeline.core.graph import Method
from pipeline.core.params import Setting, Value, list_settings
from pipeline.lab.evaluation.grid_comparison import METHOD, WEIGHTS, GridPlan, format_value
from pipeline.lab.evaluation.variants import Variant
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


def open_variant(
    label: str, evaluator: Evaluator, session: Session, report: JobReporter
) -> tuple[Variant, int]:
    """A session's variant and its frame; raises TouchError."""
    translation, frame = evaluator.open_frame(session, report)
    return Variant(label=label, translation=translation, params=session.params), frame


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
        names = [
            m.name
            for m in catalogue.list_choices(method.stage)
            if m.fits(sensor_kinds.get(method.key, ""))
        ]
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
    base = value or (setting.step or 1.0)
    values = sorted(
        {min(max(base * factor, setting.low), setting.high) for factor in _FACTORS} | {float(value)}
    )
    return (
        tuple(dict.fromkeys(round(v) for v in values)) if isinstance(value, int) else tuple(values)
    )


def format_compare_command(
    session: Session, last_stage: str, target: str, out: Path, plan: GridPlan | None = None
) -> str:
    """`tactoscope compare ...` for the current tab, or for a grid.

    `last_stage` and `target` are the opened ones.
    """
    words = [
        "tactoscope",
        "compare",
        *_list_options(session, target),
        "--frame",
        str(session.frame),
    ]
    settings = session.comparison
    if plan is not None:
        for option, axis in zip(("--across", "--down"), plan.axes, strict=False):
            words += [option, f"{axis.title}={','.join(map(_spell, axis.values))}"]
        words += ["--metric", plan.metric]
    elif settings.tab == "methods":
        words += ["--order", settings.order]
    elif session.variant is not None:
        words += [
            "--stage",
            last_stage if settings.stage == LAST_STAGE else settings.stage or "all",
        ]
        words += ["--variant", shlex.join(_list_options(session.variant, target))]
    display = [
        word for line in format_settings({"display": session.display}) for word in ("--set", line)
    ]
    return shlex.join([*words, *display, "--out", os.fspath(out.absolute())])


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
    return [
        *format_options(request),
        *(word for line in format_settings(params) for word in ("--set", line)),
    ]


def describe_differences(
    one: Session, other: Session, catalogue: Catalogue, *, has_mesh: bool = False
) -> tuple[str, ...]:
    """List as `name: one | other` everything that the results of a frame depend on and that
    differs; `has_mesh` decides the route of a session that names none.
    """
    texts = [
        _format_pair(name.replace("_", " "), getattr(one, name), getattr(other, name))
        for name in REQUEST_FIELDS
        if getattr(one, name) != getattr(other, name)
    ]
    if one.offsets != other.offsets:
        texts.append("alignment offsets differ")
    methods = tuple(
        {m.stage: m for m in catalogue.methods(route.name, session.methods)}
        for session in (one, other)
        for route in (catalogue.route(session.route, has_mesh=has_mesh),)
    )
    for stage in dict.fromkeys((*methods[0], *methods[1])):
        a, b = (by_stage.get(stage) for by_stage in methods)
        if a is None or b is None or a.key != b.key:
            texts.append(
                _format_pair(
                    catalogue.stage(stage).title,
                    "nothing" if a is None else a.title,
                    "nothing" if b is None else b.title,
                )
            )
        else:
            title = catalogue.stage(stage).title
            texts += _compare_params(a, title, one, other)
    if one.weights != other.weights:
        texts.append("weights differ")
    return tuple(texts)


def _compare_params(method: Method, title: str, one: Session, other: Session) -> list[str]:
    a, b = (list_settings(session.get_params(method)) for session in (one, other))
    return [
        _format_pair(f"{title}, {a[name][1].label.lower()}", a[name][0], b[name][0])
        for name in a
        if a[name][0] != b[name][0]
    ]


def _format_pair(name: str, one: object, other: object) -> str:
    return f"{name}: {_format_value(one)} | {_format_value(other)}"


def _format_value(value: object) -> str:
    if isinstance(value, Path):
        return value.name
    return (
        f"{value:g}"
        if isinstance(value, float)
        else "as recorded"
        if value in ("", None)
        else str(value)
    )
