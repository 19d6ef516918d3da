"""What differs between two sessions, in words."""

from __future__ import annotations

from pathlib import Path

from app.session.state import REQUEST_FIELDS, Session
from pipeline.base.params import list_settings
from pipeline.engine.graph import Method
from pipeline.translation.catalogue import Catalogue


def describe_differences(one: Session, other: Session, catalogue: Catalogue) -> tuple[str, ...]:
    """Each as `name: one | other`: everything that a frame's results rest on."""
    found = [
        _told(name.replace("_", " "), getattr(one, name), getattr(other, name))
        for name in REQUEST_FIELDS
        if getattr(one, name) != getattr(other, name)
    ]
    if one.offsets != other.offsets:
        found.append("the alignment is moved otherwise")
    methods = tuple({m.stage: m for m in catalogue.methods(session.route, session.methods)} for session in (one, other))
    for slot in dict.fromkeys((*methods[0], *methods[1])):
        a, b = (there.get(slot) for there in methods)
        if a is None or b is None or a.key != b.key:
            found.append(_told(slot, "nothing" if a is None else a.title, "nothing" if b is None else b.title))
        else:
            found += _of_params(a, one, other)
    if one.weights != other.weights:
        found.append("other weights")
    return tuple(found)


def _of_params(method: Method, one: Session, other: Session) -> list[str]:
    a, b = (list_settings(session.get_params(method)) for session in (one, other))
    return [_told(f"{method.stage}.{name}", a[name][0], b[name][0]) for name in a if a[name][0] != b[name][0]]


def _told(name: str, one: object, other: object) -> str:
    return f"{name}: {_word(one)} | {_word(other)}"


def _word(value: object) -> str:
    if isinstance(value, Path):
        return value.name
    return f"{value:g}" if isinstance(value, float) else "as recorded" if value in ("", None) else str(value)
