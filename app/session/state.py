"""The session: everything a user chose, as one immutable value, and its file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast, get_args

from app.session.comparison_settings import ComparisonSettings
from app.session.comparison_settings import from_plain as comparison_from_plain
from app.session.layout import Layout
from app.session.layout import from_plain as layout_from_plain
from app.session.view_state import parse_cameras, parse_section_line
from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.base.files import read_json, write_json
from pipeline.base.params import list_settings, replace_value
from pipeline.engine.graph import Method
from pipeline.previews.display_params import DisplayParams
from pipeline.recordings.formats import DepthUnit
from pipeline.sensors.offsets import Offsets, parse_offsets
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.cross_section import SectionLine

SESSION_SUFFIX = ".touch.json"
DISPLAY_KEY = "display"  # key of the display parameters in `Session.params`
AUTO_FRAME = -1  # frame number that stands for the first frame with contact, detected when the recording opens
_VERSION = 3  # of the session file
PATH_FIELDS = ("recording", "reference", "calibration", "mesh", "alignment")
_TEXT_FIELDS = ("source", "target", "stream", "route", "mesh_unit")
REQUEST_FIELDS = (*PATH_FIELDS, *_TEXT_FIELDS, "depth_unit")  # fields that a session and a request share
_OFFSET_FIELDS = frozenset({"source", "target", "stream", "alignment"})  # offsets are valid only for these values


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What is open, how it is shown, and every parameter. The undo stack holds values of this class."""

    recording: Path | None = None
    source: str = ""  # sensor, "" = the one that the recording names
    target: str = ""  # "" = the first sensor that is not the source
    stream: str = ""
    route: str = "t2d2"
    frame: int = 0  # or AUTO_FRAME
    reference: Path | None = None
    calibration: Path | None = None
    mesh: Path | None = None
    mesh_unit: str = "auto"
    depth_unit: DepthUnit = "auto"  # of depth arrays whose file states no unit
    alignment: Path | None = None  # TOML with T_S->A and T_A->T; None = of the recording or the sensors
    offsets: Offsets = field(default_factory=Offsets)  # motion added by hand or by refinement
    layout: Layout = field(default_factory=Layout)
    cameras_linked: bool = True  # 3D views of one frame share their camera
    methods: Mapping[str, str] = field(default_factory=dict)  # stage -> method that replaces the route's
    weights: Mapping[str, Path] = field(default_factory=dict)  # stage -> file; "" = the first that reads weights
    params: Mapping[str, object] = field(default_factory=dict)  # changed parameters: by method key, and DISPLAY_KEY
    notes: Mapping[int, str] = field(default_factory=dict)  # frame -> note of the user
    comparison: ComparisonSettings = field(default_factory=ComparisonSettings)
    variant: Session | None = None  # session B of the comparison, if any
    # 3D view -> camera. Cameras and section are saved, but changing them is no undo step and no unsaved change.
    cameras: Mapping[str, tuple[float, ...]] = field(default_factory=dict, compare=False)
    section: SectionLine | None = field(default=None, compare=False)  # section line through all images

    def get_params(self, method: Method) -> object:
        """Parameters of a method; its defaults if unchanged."""
        return self.params.get(method.key, method.params())

    def collect_params(self, methods: Iterable[Method]) -> dict[str, object]:
        """Stage -> parameters of the method that computes it."""
        return {method.stage: self.get_params(method) for method in methods}

    def with_updates(self, **updates: Any) -> Session:
        """Copy with other values; offsets are reset where the alignment they were made for changes.

        A new recording keeps offsets only with an alignment file, which holds for any recording of the two sensors.
        """
        new = replace(self, **updates)
        if new.recording != self.recording and "notes" not in updates:
            new = replace(new, notes={})
        if "offsets" in updates:
            return new
        is_other_alignment = any(getattr(new, name) != getattr(self, name) for name in _OFFSET_FIELDS)
        is_other_alignment = is_other_alignment or (new.recording != self.recording and self.alignment is None)
        return replace(new, offsets=Offsets()) if is_other_alignment else new

    def with_draft_params(self, methods: Iterable[Method]) -> Session:
        """Copy with the draft parameters of these methods, for previews while a parameter is dragged."""
        drafts = {m.key: m.draft(self.get_params(m)) for m in methods if m.draft is not None}
        return replace(self, params={**self.params, **drafts}) if drafts else self

    @property
    def settings(self) -> Session:
        """Copy with only what metrics depend on besides the frame; metrics of equal settings are comparable."""
        return replace(
            self, frame=0, cameras_linked=True, layout=Layout(), notes={}, comparison=ComparisonSettings(),
            variant=None, params={**self.params, "display": DisplayParams()},
        )  # fmt: skip

    @property
    def display(self) -> DisplayParams:
        """Display parameters."""
        return cast("DisplayParams", self.params.get(DISPLAY_KEY, DisplayParams()))


def save_session(session: Session, path: Path, contents: Mapping[str, str] | None = None) -> None:
    """Write `session` atomically; `contents` are the fingerprints of its files (`app.session.file_fingerprints`)."""
    data = _plain(session, path.parent)
    if contents is not None:
        data["contents"] = dict(contents)
    write_json(path, data, "the session")


def _plain(session: Session, folder: Path) -> dict[str, Any]:
    data: dict[str, Any] = {
        "tactoscope session": _VERSION,
        "frame": max(0, session.frame),
        "cameras_linked": session.cameras_linked,
    }
    data |= {name: getattr(session, name) for name in (*_TEXT_FIELDS, "depth_unit")}
    for name in PATH_FIELDS:
        value: Path | None = getattr(session, name)
        data[name] = None if value is None else _relative(value, folder)
    data["offsets"], data["layout"] = asdict(session.offsets), session.layout.plain
    data["methods"] = dict(session.methods)
    data["weights"] = {stage: _relative(file, folder) for stage, file in session.weights.items()}
    data["params"] = {
        key: {name: value for name, (value, _) in list_settings(params).items()}
        for key, params in session.params.items()
    }
    data["notes"] = {str(frame): text for frame, text in sorted(session.notes.items())}
    data["comparison"], data["cameras"] = session.comparison.plain, {n: list(c) for n, c in session.cameras.items()}
    data["section"] = None if session.section is None else session.section.plain
    data["variant"] = None if session.variant is None else _plain(replace(session.variant, variant=None), folder)
    return data


def load_session(path: Path, catalogue: Catalogue = BUILT_IN) -> Session:
    """Read a session file; raises FileProblem that names the invalid field."""
    return _parse_session(read_json(path, "the session"), path, catalogue)


def _parse_session(data: object, path: Path, catalogue: Catalogue) -> Session:
    if not isinstance(data, dict) or "tactoscope session" not in data:
        raise FileProblem("this is not a session file", path)
    version = data["tactoscope session"]
    if version != _VERSION:
        raise FileProblem(f"the session has version {version!r}, this program reads {_VERSION}", path)
    table = cast("dict[str, Any]", data)
    texts = {name: _read_field(table, name, str, path) for name in _TEXT_FIELDS}
    unit = table.get("depth_unit", "auto")
    if unit not in get_args(DepthUnit):
        raise FileProblem(f"depth_unit must be one of {', '.join(get_args(DepthUnit))}, got {unit!r}", path,
                          field="depth_unit")  # fmt: skip
    methods = cast("dict[str, str]", table.get("methods", {}))
    try:
        catalogue.methods(texts["route"], methods)
    except (SettingProblem, TypeError, ValueError) as error:
        raise FileProblem(f"the session's route or methods cannot be used ({error})", path, field="route") from error
    frame = _read_field(table, "frame", int, path)
    if frame < 0:
        raise FileProblem(f"frame must not be negative, got {frame}", path, field="frame")
    return Session(
        **{name: _path(table, name, path) for name in PATH_FIELDS},
        **texts,
        depth_unit=unit,
        frame=frame,
        offsets=_offsets(table, path),
        layout=_layout(table, path),
        cameras_linked=_read_field(table, "cameras_linked", bool, path),
        methods=methods,
        weights=_weights(table, path),
        params=_params(table.get("params", {}), path, catalogue),
        notes=_notes(table, path),
        comparison=_comparison(table, path),
        variant=None if table.get("variant") is None else _parse_session(table["variant"], path, catalogue),
        cameras=parse_cameras(table, path),
        section=parse_section_line(table, path),
    )


def _relative(value: Path, folder: Path) -> str:
    """Path relative to the session file, if at most three folders up, so that a folder can be moved as a whole."""
    full = os.path.abspath(value)  # noqa: PTH100 - resolve() would follow links
    try:
        relative = os.path.relpath(full, os.path.abspath(folder))  # noqa: PTH100 - as above
    except ValueError:  # another drive
        return full
    return relative if relative.count("..") <= 3 else full


def _read_field(data: Mapping[str, Any], name: str, kind: type, path: Path) -> Any:
    if name not in data:
        raise FileProblem(f"the session lacks {name}", path, field=name)
    value = data[name]
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise FileProblem(f"{name} must be of type {kind.__name__}, got {value!r}", path, field=name)
    return value


def _path(data: Mapping[str, Any], name: str, path: Path) -> Path | None:
    if data.get(name) is None:
        return None
    return path.parent / str(_read_field(data, name, str, path))


def _weights(data: Mapping[str, Any], path: Path) -> Mapping[str, Path]:
    files = data.get("weights", {})
    if not isinstance(files, dict) or not all(isinstance(name, str) for name in cast("dict[str, Any]", files).values()):
        raise FileProblem("weights must map stages to files", path, field="weights")
    return {stage: path.parent / name for stage, name in cast("dict[str, str]", files).items()}


def _notes(data: Mapping[str, Any], path: Path) -> Mapping[int, str]:
    notes = data.get("notes", {})
    entries = cast("dict[str, Any]", notes) if isinstance(notes, dict) else {"": None}
    if not all(frame.isdigit() and isinstance(text, str) for frame, text in entries.items()):
        raise FileProblem("notes must map frames to texts", path, field="notes")
    return {int(frame): str(text) for frame, text in entries.items()}


def _offsets(data: Mapping[str, Any], path: Path) -> Offsets:
    try:
        return parse_offsets(data.get("offsets"))
    except ValueError as error:
        raise FileProblem(f"the session's offsets cannot be used ({error})", path, field="offsets") from error


def _layout(data: Mapping[str, Any], path: Path) -> Layout:
    try:
        return layout_from_plain(data.get("layout"))
    except ValueError as error:
        raise FileProblem(f"the session's layout cannot be used ({error})", path, field="layout") from error


def _comparison(data: Mapping[str, Any], path: Path) -> ComparisonSettings:
    try:
        return comparison_from_plain(data.get("comparison"))
    except ValueError as error:
        raise FileProblem(f"the comparison settings cannot be used ({error})", path, field="comparison") from error


def _params(data: object, path: Path, catalogue: Catalogue) -> Mapping[str, object]:
    if not isinstance(data, dict):
        raise FileProblem("params must map methods to their parameters", path, field="params")
    defaults: dict[str, object] = {m.key: m.params() for stage in catalogue.stages for m in stage.methods}
    defaults[DISPLAY_KEY] = DisplayParams()
    params: dict[str, object] = {}
    for key, values in cast("dict[str, Any]", data).items():
        if key not in defaults or not isinstance(values, dict):
            raise FileProblem(f"params.{key} is not a method with parameters", path, field=f"params.{key}")
        params[key] = defaults[key]
        for name, value in cast("dict[str, Any]", values).items():
            try:
                params[key] = replace_value(params[key], name, value)
            except (SettingProblem, TypeError) as error:
                where = f"params.{key}.{name}"
                raise FileProblem(f"{where} cannot be used ({error})", path, field=where) from error
    return params
