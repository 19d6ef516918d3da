"""Differences between two sessions, as text."""

from pathlib import Path

from app.session.state import REQUEST_FIELDS, Session
from pipeline.base.params import list_settings
from pipeline.engine.graph import Method
from pipeline.translation.catalogue import Catalogue


def describe_differences(one: Session, other: Session, catalogue: Catalogue) -> tuple[str, ...]:
    """List as `name: one | other` everything that the results of a frame depend on and that differs."""
    texts = [
        _format_pair(name.replace("_", " "), getattr(one, name), getattr(other, name))
        for name in REQUEST_FIELDS
        if getattr(one, name) != getattr(other, name)
    ]
    if one.offsets != other.offsets:
        texts.append("alignment offsets differ")
    methods = tuple({m.stage: m for m in catalogue.methods(session.route, session.methods)} for session in (one, other))
    for stage in dict.fromkeys((*methods[0], *methods[1])):
        a, b = (by_stage.get(stage) for by_stage in methods)
        if a is None or b is None or a.key != b.key:
            texts.append(_format_pair(stage, "nothing" if a is None else a.title, "nothing" if b is None else b.title))
        else:
            texts += _compare_params(a, one, other)
    if one.weights != other.weights:
        texts.append("weights differ")
    return tuple(texts)


def _compare_params(method: Method, one: Session, other: Session) -> list[str]:
    a, b = (list_settings(session.get_params(method)) for session in (one, other))
    return [_format_pair(f"{method.stage}.{name}", a[name][0], b[name][0]) for name in a if a[name][0] != b[name][0]]


def _format_pair(name: str, one: object, other: object) -> str:
    return f"{name}: {_format_value(one)} | {_format_value(other)}"


def _format_value(value: object) -> str:
    if isinstance(value, Path):
        return value.name
    return f"{value:g}" if isinstance(value, float) else "as recorded" if value in ("", None) else str(value)
