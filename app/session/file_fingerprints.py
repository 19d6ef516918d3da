"""Fingerprints of a session's files, so that opening the session reports which files changed
since.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from app.session.state import PATH_FIELDS, Session
from pipeline.core.digests import compute_fingerprint
from pipeline.core.files import read_json

_VARIANT = "variant."  # prefix of the files that the variant opens


def list_files(session: Session) -> Mapping[str, Path]:
    """Field -> file or folder that a session opens; weights as `weights.<stage>`."""
    paths = {name: cast("Path | None", getattr(session, name)) for name in PATH_FIELDS}
    files = {name: path for name, path in paths.items() if path is not None}
    files |= {f"weights.{stage}": path for stage, path in session.weights.items()}
    if session.variant is not None:
        files |= {f"{_VARIANT}{name}": path for name, path in list_files(session.variant).items()}
    return files


def fingerprint_files(session: Session) -> dict[str, str]:
    """Field -> fingerprint of the file as it is now."""
    return {name: compute_fingerprint(path) for name, path in list_files(session).items()}


def describe_changed_files(path: Path, session: Session) -> tuple[str, ...]:
    """List one sentence per file that changed or is missing since the session at `path` was
    saved.
    """
    data: object = cast("dict[str, Any]", read_json(path, "the session")).get("contents", {})
    saved = cast("dict[str, object]", data) if isinstance(data, dict) else {}
    sentences: list[str] = []
    for name, file in list_files(session).items():
        now = compute_fingerprint(file)
        if name in saved and saved[name] != now:
            role = name.removeprefix(_VARIANT).replace("_", " ").partition(".")[0]
            sentences.append(
                f"the {role} has changed since the session was saved: '{file}'"
                if now
                else f"the {role} of the session is missing: '{file}'"
            )
    return tuple(sentences)
