"""What the files of a session held when it was saved, so that opening it says which have changed since."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from app.session.state import PATH_FIELDS, Session
from pipeline.base.files import read_json
from pipeline.base.fingerprints import compute_fingerprint

_VARIANT = "variant."  # prefix of the files that the variant opens


def list_files(session: Session) -> Mapping[str, Path]:
    """Field -> file or folder of everything that a session opens; weights as `weights.slot`."""
    named = {name: cast("Path | None", getattr(session, name)) for name in PATH_FIELDS}
    opened = {name: path for name, path in named.items() if path is not None}
    opened |= {f"weights.{slot}": path for slot, path in session.weights.items()}
    if session.variant is not None:
        opened |= {f"{_VARIANT}{name}": path for name, path in list_files(session.variant).items()}
    return opened


def fingerprint_files(session: Session) -> dict[str, str]:
    """Field -> fingerprint of what is there now."""
    return {name: compute_fingerprint(path) for name, path in list_files(session).items()}


def describe_changed_files(path: Path, session: Session) -> tuple[str, ...]:
    """One sentence for every file that holds something else than when the session at `path` was saved, or is gone."""
    said: object = cast("dict[str, Any]", read_json(path, "the session")).get("contents", {})
    kept = cast("dict[str, object]", said) if isinstance(said, dict) else {}
    sentences: list[str] = []
    for name, file in list_files(session).items():
        now = compute_fingerprint(file)
        if name in kept and kept[name] != now:
            what = name.removeprefix(_VARIANT).replace("_", " ").partition(".")[0]
            sentences.append(
                f"the {what} has changed since the session was saved: '{file}'"
                if now
                else f"the {what} of the session is not there any more: '{file}'"
            )
    return tuple(sentences)
