"""Everything that a user chose, as one immutable value, and the file it is kept in."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast, get_args

from app.session.comparison_settings import ComparisonSettings
from app.session.comparison_settings import from_plain as compared_from_plain
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
DISPLAY_KEY = "display"  # the key of its parameters
AUTO_FRAME = -1  # in place of a frame: one on which something touches, found when the recording is open
_VERSION = 2
_FORMER = {  # stages of version 1 -> keys of methods
    "depth": "depth/physics",
    "adapt": "cloud/back_projection",
    "project": "target_depth/surface",
    "generate": "touch/physics",
    "pose": "pose/signed_distances",
}
_FORMER_CHOICES = {  # parameters of version 1 that chose what is a method now
    ("project", "mode", "paper"): ("target_depth", "paper"),
    ("pose", "method", "paper 2D"): ("pose", "paper_2d"),
}
PATH_FIELDS = ("recording", "reference", "calibration", "mesh", "alignment")
_WORDS = ("source", "target", "stream", "route", "mesh_unit")
REQUEST_FIELDS = (*PATH_FIELDS, *_WORDS, "depth_unit")  # what a session and a request share
_FRAMES_OF_OFFSETS = frozenset({"source", "target", "stream", "alignment"})  # another of these is another motion


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What is open, what is shown of it, and every parameter. Undo is a stack of these."""

    recording: Path | None = None
    source: str = ""  # "" = as the recording says
    target: str = ""  # "" = the first sensor that is not the source
    stream: str = ""
    route: str = "t2d2"
    frame: int = 0  # or `ON_A_TOUCH`
    reference: Path | None = None
    calibration: Path | None = None
    mesh: Path | None = None
    mesh_unit: str = "auto"
    depth_unit: DepthUnit = "auto"  # of depth whose file does not tell
    alignment: Path | None = None  # TOML with T_S->A and T_A->T; None = the recording's or the descriptions'
    offsets: Offsets = field(default_factory=Offsets)  # how far it was moved by hand or by refining
    layout: Layout = field(default_factory=Layout)
    cameras_linked: bool = True  # 3D views of one frame share their camera
    methods: Mapping[str, str] = field(default_factory=dict)  # slot -> method in place of the route's own
    weights: Mapping[str, Path] = field(default_factory=dict)  # slot -> file; slot "" = the first whose method takes it
    params: Mapping[str, object] = field(default_factory=dict)  # changed ones: of methods by key, of the display
    notes: Mapping[int, str] = field(default_factory=dict)  # frame -> what somebody wrote of it
    comparison: ComparisonSettings = field(default_factory=ComparisonSettings)
    variant: Session | None = None  # that *Compare* holds beside this one, None = there is none
    # 3D view -> where it looks from and to, as it was when the session was saved: turning one is no change to be saved.
    cameras: Mapping[str, tuple[float, ...]] = field(default_factory=dict, compare=False)
    section: SectionLine | None = field(default=None, compare=False)  # the line through all pictures, likewise

    def get_params(self, method: Method) -> object:
        """The parameters of a method, as they come where nobody changed them."""
        return self.params.get(method.key, method.params())

    def collect_params(self, methods: Iterable[Method]) -> dict[str, object]:
        """Slot -> the parameters of the method that fills it."""
        return {method.stage: self.get_params(method) for method in methods}

    def with_updates(self, **updates: Any) -> Session:
        """The same with other values; offsets from an alignment that is no longer the opened one are taken back.

        Another recording keeps those from a file, which says how its two sensors stand whoever recorded them.
        """
        new = replace(self, **updates)
        if new.recording != self.recording and "notes" not in updates:
            new = replace(new, notes={})
        if "offsets" in updates:
            return new
        other = any(getattr(new, name) != getattr(self, name) for name in _FRAMES_OF_OFFSETS)
        other = other or (new.recording != self.recording and self.alignment is None)
        return replace(new, offsets=Offsets()) if other else new

    def with_draft_params(self, methods: Iterable[Method]) -> Session:
        """The same with cheaper parameters of those methods that have some: to show while one is dragged."""
        cheap = {m.key: m.draft(self.get_params(m)) for m in methods if m.draft is not None}
        return replace(self, params={**self.params, **cheap}) if cheap else self

    @property
    def settings(self) -> Session:
        """What figures rest on besides the frame: those of sessions with equal settings may stand side by side."""
        return replace(
            self, frame=0, cameras_linked=True, layout=Layout(), notes={}, comparison=ComparisonSettings(), variant=None,
            params={**self.params, "display": DisplayParams()},
        )  # fmt: skip

    @property
    def display(self) -> DisplayParams:
        """How things are drawn."""
        return cast("DisplayParams", self.params.get(DISPLAY_KEY, DisplayParams()))


def save_session(session: Session, path: Path, contents: Mapping[str, str] | None = None) -> None:
    """Write `session`, beside the old file first so that a crash leaves one of the two whole.

    `contents` says what the files held that it names, see `app.session.file_fingerprints`.
    """
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
    data |= {name: getattr(session, name) for name in (*_WORDS, "depth_unit")}
    for name in PATH_FIELDS:
        value: Path | None = getattr(session, name)
        data[name] = None if value is None else _relative(value, folder)
    data["offsets"], data["layout"] = asdict(session.offsets), session.layout.plain
    data["methods"] = dict(session.methods)
    data["weights"] = {slot: _relative(file, folder) for slot, file in session.weights.items()}
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
    """Read a session; raises FileProblem naming the field that is wrong."""
    return _loaded(read_json(path, "the session"), path, catalogue)


def _loaded(data: object, path: Path, catalogue: Catalogue) -> Session:
    if not isinstance(data, dict) or "tactoscope session" not in data:
        raise FileProblem("this is not a session file", path)
    version = data["tactoscope session"]
    if version not in (1, _VERSION):
        raise FileProblem(f"the session has version {version!r}, this program reads 1 and {_VERSION}", path)
    known = cast("dict[str, Any]", data)
    words = {name: _typed(known, name, str, path) for name in _WORDS}
    unit = known.get("depth_unit", "auto")  # files from before it could be said lack it
    if unit not in get_args(DepthUnit):
        raise FileProblem(f"depth_unit must be one of {', '.join(get_args(DepthUnit))}, got {unit!r}", path,
                          field="depth_unit")  # fmt: skip
    methods = _former_methods(known) if version == 1 else cast("dict[str, str]", known.get("methods", {}))
    try:
        catalogue.methods(words["route"], methods)
    except (SettingProblem, TypeError, ValueError) as error:
        raise FileProblem(f"the session's route or methods cannot be used ({error})", path, field="route") from error
    frame = _typed(known, "frame", int, path)
    if frame < 0:
        raise FileProblem(f"frame must not be negative, got {frame}", path, field="frame")
    return Session(
        **{name: _path(known, name, path) for name in PATH_FIELDS},
        **words,
        depth_unit=unit,
        frame=frame,
        offsets=_offsets(known, path),
        layout=_layout(known, path),
        cameras_linked=_typed(known, "cameras_linked", bool, path),
        methods=methods,
        weights=_weights(known, path),
        params=_params(known.get("params", {}), path, catalogue, former=version == 1),
        notes=_notes(known, path),
        comparison=_compared(known, path),
        variant=None if known.get("variant") is None else _loaded(known["variant"], path, catalogue),
        cameras=parse_cameras(known, path),
        section=parse_section_line(known, path),
    )


def _former_methods(data: Mapping[str, Any]) -> dict[str, str]:
    params = data.get("params")
    said = cast("dict[str, Any]", params) if isinstance(params, dict) else {}
    return dict(
        chosen
        for (stage, name, value), chosen in _FORMER_CHOICES.items()
        if isinstance(said.get(stage), dict) and said[stage].get(name) == value
    )


def _relative(value: Path, folder: Path) -> str:
    """Relative to the session file if that is no long climb, so that a folder can be moved as a whole."""
    full = os.path.abspath(value)  # noqa: PTH100 - resolve() would follow links the user meant to keep
    try:
        relative = os.path.relpath(full, os.path.abspath(folder))  # noqa: PTH100 - as above
    except ValueError:  # another drive
        return full
    return relative if relative.count("..") <= 3 else full


def _typed(data: Mapping[str, Any], name: str, kind: type, path: Path) -> Any:
    if name not in data:
        raise FileProblem(f"the session lacks {name}", path, field=name)
    value = data[name]
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise FileProblem(f"{name} must be of type {kind.__name__}, got {value!r}", path, field=name)
    return value


def _path(data: Mapping[str, Any], name: str, path: Path) -> Path | None:
    if data.get(name) is None:
        return None
    return path.parent / str(_typed(data, name, str, path))


def _weights(data: Mapping[str, Any], path: Path) -> Mapping[str, Path]:
    """None at all in files from before methods by network."""
    said = data.get("weights", {})
    if not isinstance(said, dict) or not all(isinstance(name, str) for name in cast("dict[str, Any]", said).values()):
        raise FileProblem("weights must map slots to files", path, field="weights")
    return {slot: path.parent / name for slot, name in cast("dict[str, str]", said).items()}


def _notes(data: Mapping[str, Any], path: Path) -> Mapping[int, str]:
    """None at all in files from before frames could be noted."""
    said = data.get("notes", {})
    known = cast("dict[str, Any]", said) if isinstance(said, dict) else {"": None}
    if not all(frame.isdigit() and isinstance(text, str) for frame, text in known.items()):
        raise FileProblem("notes must map frames to texts", path, field="notes")
    return {int(frame): str(text) for frame, text in known.items()}


def _offsets(data: Mapping[str, Any], path: Path) -> Offsets:
    """None at all in files from before alignments could be moved."""
    if "offsets" not in data:
        return Offsets()
    try:
        return parse_offsets(data["offsets"])
    except ValueError as error:
        raise FileProblem(f"the session's offsets cannot be used ({error})", path, field="offsets") from error


def _layout(data: Mapping[str, Any], path: Path) -> Layout:
    """The usual one in files from before there were others."""
    try:
        return layout_from_plain(data.get("layout"))
    except ValueError as error:
        raise FileProblem(f"the session's layout cannot be used ({error})", path, field="layout") from error


def _compared(data: Mapping[str, Any], path: Path) -> ComparisonSettings:
    try:
        return compared_from_plain(data.get("comparison"))
    except ValueError as error:
        raise FileProblem(f"what the session compared cannot be used ({error})", path, field="comparison") from error


def _params(data: object, path: Path, catalogue: Catalogue, *, former: bool) -> Mapping[str, object]:
    if not isinstance(data, dict):
        raise FileProblem("params must map methods to their parameters", path, field="params")
    known: dict[str, object] = {m.key: m.params() for slot in catalogue.stages for m in slot.methods}
    known[DISPLAY_KEY] = DisplayParams()
    params: dict[str, object] = {}
    for said, values in cast("dict[str, Any]", data).items():
        key = _FORMER.get(said, said) if former else said
        if key not in known or not isinstance(values, dict):
            raise FileProblem(f"params.{said} is not a method with parameters", path, field=f"params.{said}")
        params[key] = known[key]
        for name, value in cast("dict[str, Any]", values).items():
            if former and name not in list_settings(params[key]):  # what has become a method of its own
                continue
            try:
                params[key] = replace_value(params[key], name, value)
            except (SettingProblem, TypeError) as error:
                where = f"params.{said}.{name}"
                raise FileProblem(f"{where} cannot be used ({error})", path, field=where) from error
    return params
