"""The session: everything a user chose, as one immutable value, and its file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, cast

import msgspec
from msgspec import Meta

from app.session.layout import ComparisonSettings, Layout
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import read_json, write_json
from pipeline.core.frozen import frozen
from pipeline.core.graph import Method
from pipeline.core.params import list_settings, replace_value
from pipeline.core.typed_data import FileName, Name, Note, Number, Plain, convert, to_plain
from pipeline.io.formats import DepthUnit
from pipeline.sensors.alignment import Offsets
from pipeline.stages.networks.devices import AUTO
from pipeline.stages.stage import TRUTH
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.cross_section import SectionLine
from pipeline.views.display_params import DisplayParams

SESSION_SUFFIX = ".touch.json"
DISPLAY_KEY = "display"  # key of the display parameters in `Session.params`
# frame number that stands for the first frame with contact, detected when the recording opens
AUTO_FRAME = -1
_VERSION = 3  # of the session file
_N_CAMERA = 10  # numbers of a 3D view: position (3), focal point (3), view-up (3), view angle
# of the section line's ends; beyond any sensor
_SectionMm = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
_Number = Annotated[int, Meta(ge=0, le=2**31 - 1)]  # of a frame or tick; what Qt counts with
PATH_FIELDS = ("recording", "reference", "calibration", "mesh", "alignment")
_CHOICES = (
    "source",
    "target",
    "stream",
    "reference_frames",
    "route",
    "mesh_unit",
    "depth_unit",
)
_PLAIN_FIELDS = (
    *_CHOICES,
    "cameras_linked",
    "offsets",
    "layout",
    "methods",
    "notes",
    "comparison",
    "cameras",
    "tick",
)
# fields that a session and a request share; the device is the machine's, and in no file
REQUEST_FIELDS = (*PATH_FIELDS, *_CHOICES, "device")
# offsets are valid only for these values
_OFFSET_FIELDS = frozenset({"source", "target", "stream", "alignment"})


@frozen
class Session:
    """What is open, how it is shown, and every parameter. The undo stack holds values of this
    class.
    """

    recording: Path | None = None
    source: str = ""  # sensor, "" = the one that the recording names
    target: str = ""  # "" = the first sensor that is not the source
    stream: str = ""
    route: str = ""  # "" = the default for what is known of the object
    frame: int = 0  # or AUTO_FRAME
    reference: Path | None = None
    reference_frames: str = ""  # frames of the recording to make the reference of
    calibration: Path | None = None
    mesh: Path | None = None
    mesh_unit: str = "auto"
    depth_unit: DepthUnit = "auto"  # of depth arrays whose file states no unit
    device: str = AUTO  # that networks run on
    # TOML with T_S->A and T_A->T; None = of the recording or the sensors
    alignment: Path | None = None
    offsets: Offsets = field(default_factory=Offsets)  # motion added by hand or by refinement
    layout: Layout = field(default_factory=Layout)
    cameras_linked: bool = True  # 3D views of one frame share their camera
    # stage -> method that replaces the route's
    methods: Mapping[str, str] = field(default_factory=dict)
    # stage -> file; "" = the first that reads weights
    weights: Mapping[str, Path] = field(default_factory=dict)
    # changed parameters: by method key, and DISPLAY_KEY
    params: Mapping[str, object] = field(default_factory=dict)
    notes: Mapping[int, str] = field(default_factory=dict)  # frame -> note of the user
    comparison: ComparisonSettings = field(default_factory=ComparisonSettings)
    variant: Session | None = None  # session B of the comparison, if any
    # 3D view -> camera. Cameras, section and tick are saved, but changing them is no undo step and
    # no unsaved change.
    cameras: Mapping[str, tuple[float, ...]] = field(default_factory=dict, compare=False)
    # section line through all images
    section: SectionLine | None = field(default=None, compare=False)
    tick: int = field(default=0, compare=False)  # of the rollout in the Task layout

    def get_params(self, method: Method) -> object:
        """Parameters of a method; its defaults if unchanged."""
        return self.params.get(method.key, method.params())

    def collect_params(self, methods: Iterable[Method]) -> dict[str, object]:
        """Stage -> parameters of the method that computes it."""
        return {method.stage: self.get_params(method) for method in methods}

    def with_updates(self, **updates: Any) -> Session:
        """Copy with other values; offsets are reset where the alignment they were made for changes.

        Notes, pinned truths and colour limits end with their recording.

        A new recording keeps offsets only with an alignment file, which holds for any recording of
        the two sensors.
        """
        changed = {name for name, value in updates.items() if value != getattr(self, name)}
        is_other = "recording" in changed
        if is_other:
            own = {stage: name for stage, name in self.methods.items() if name != TRUTH}
            params = {**self.params}
            if DISPLAY_KEY in params:
                params[DISPLAY_KEY] = self.display.without_limits()
            updates = {"notes": {}, "methods": own, "params": params, **updates}
        if changed & _OFFSET_FIELDS or (is_other and self.alignment is None):
            updates = {"offsets": Offsets(), **updates}
        return replace(self, **updates)

    def with_device(self, device: str) -> Session:
        """Copy whose networks, and those of session B, run on another device."""
        other = self.variant and self.variant.with_device(device)
        return replace(self, device=device, variant=other)

    def with_draft_params(self, methods: Iterable[Method]) -> Session:
        """Copy with the draft parameters of these methods, for previews while a parameter is
        dragged.
        """
        drafts = {m.key: m.draft(self.get_params(m)) for m in methods if m.draft is not None}
        return replace(self, params={**self.params, **drafts}) if drafts else self

    @property
    def settings(self) -> Session:
        """Copy with only what metrics depend on besides the frame.

        Metrics of equal settings are comparable.
        """
        return replace(
            self,
            frame=0,
            cameras_linked=True,
            layout=Layout(),
            notes={},
            comparison=ComparisonSettings(),
            variant=None,
            params={**self.params, "display": DisplayParams()},
        )

    @property
    def display(self) -> DisplayParams:
        """Display parameters."""
        return cast("DisplayParams", self.params.get(DISPLAY_KEY, DisplayParams()))

    def with_display(self, display: DisplayParams) -> Session:
        """Copy with other display parameters."""
        return replace(self, params={**self.params, DISPLAY_KEY: display})


def save_session(session: Session, path: Path, contents: Mapping[str, str] | None = None) -> None:
    """Write `session` atomically.

    `contents` are the fingerprints of its files (`app.session.file_fingerprints`).
    """
    data = _plain(session, path.parent) | {"contents": dict(contents or {})}
    write_json(path, data, "the session", load_session)


def _plain(session: Session, folder: Path) -> dict[str, Any]:
    files = {name: getattr(session, name) for name in PATH_FIELDS}
    return {
        "tactoscope session": _VERSION,
        "frame": max(0, session.frame),
        **{name: to_plain(getattr(session, name)) for name in _PLAIN_FIELDS},
        **{name: file and _relative(file, folder) for name, file in files.items()},
        "weights": {stage: _relative(file, folder) for stage, file in session.weights.items()},
        "params": {
            key: {name: value for name, (value, _) in list_settings(params).items()}
            for key, params in session.params.items()
        },
        "section": session.section and session.section.plain,
        "variant": session.variant and _plain(replace(session.variant, variant=None), folder),
    }


class _SessionFile(msgspec.Struct, kw_only=True):
    """A session file; what has a default may be left out."""

    frame: _Number
    cameras_linked: bool
    source: Name
    target: Name
    stream: Name
    route: Name
    mesh_unit: Name
    depth_unit: DepthUnit = "auto"
    reference_frames: Name = ""
    recording: FileName | None = None
    reference: FileName | None = None
    calibration: FileName | None = None
    mesh: FileName | None = None
    alignment: FileName | None = None
    offsets: Offsets
    layout: Layout = msgspec.field(default_factory=Layout)
    methods: dict[Name, Name] = {}
    weights: dict[Name, FileName] = {}
    params: dict[Name, dict[Name, Plain]] = {}
    notes: dict[_Number, Note] = {}
    comparison: ComparisonSettings = msgspec.field(default_factory=ComparisonSettings)
    variant: dict[str, object] | None = None
    cameras: dict[
        Name, Annotated[tuple[Number, ...], Meta(min_length=_N_CAMERA, max_length=_N_CAMERA)]
    ] = {}
    section: tuple[_SectionMm, _SectionMm, _SectionMm, _SectionMm] | None = None
    tick: _Number = 0


def load_session(path: Path, catalogue: Catalogue = BUILT_IN) -> Session:
    """Read a session file; raises FileProblem that names the invalid field."""
    return _parse_session(read_json(path, "the session"), path, catalogue)


def _parse_session(data: object, path: Path, catalogue: Catalogue) -> Session:
    if not isinstance(data, dict) or "tactoscope session" not in data:
        raise FileProblem("this is not a session file", path)
    version = cast("dict[str, Any]", data)["tactoscope session"]
    if version != _VERSION:
        advice = "open its recording and choose the files again, or use the program that saved it"
        raise FileProblem(
            f"the session has version {version!r}, this program reads {_VERSION}; {advice}", path
        )
    said = convert(
        _rename_pages(cast("dict[str, object]", data)), _SessionFile, "the session", path
    )
    try:
        catalogue.methods(said.route, said.methods)
    except SettingProblem as error:
        raise FileProblem(
            f"the session's route or methods cannot be used ({error})", path
        ) from error
    files = {name: getattr(said, name) for name in PATH_FIELDS}
    other, line = said.variant, said.section
    return Session(
        **{name: None if file is None else path.parent / file for name, file in files.items()},
        **{name: getattr(said, name) for name in (*_PLAIN_FIELDS, "frame")},
        weights={stage: path.parent / file for stage, file in said.weights.items()},
        params=_params(said.params, path, catalogue),
        variant=None
        if other is None
        else _parse_session({**other, "variant": None}, path, catalogue),
        section=line and SectionLine(begin_mm=line[:2], end_mm=line[2:]),
    )


# parameters of older sessions that are none any more, with the value that they were left at
_REMOVED: Mapping[str, Plain] = {"boundary": "flat"}


# pages of older sessions, and what does now what they did
_RENAMED = {
    "sweep": "compare",
    "seeds": "grid",
    "stages": "look",
    "inspect": "look",
    "demo": "look",
}


def _rename_pages(data: Mapping[str, object]) -> dict[str, object]:
    """Replace pages of older sessions."""
    renamed = dict(data)
    for field_name, key in (("layout", "name"), ("comparison", "tab")):
        part = data.get(field_name)
        if isinstance(part, dict):
            old = cast("dict[str, object]", part).get(key)
            renamed[field_name] = {**part, key: _RENAMED.get(str(old), old)}
    return renamed


def describe_removed_params(path: Path) -> tuple[str, ...]:
    """List one sentence per parameter that the session at `path` has changed and that is none any
    more.
    """
    said = cast("dict[str, dict[str, dict[str, Plain]]]", read_json(path, "the session"))
    return tuple(
        f"{method}: {name} is no setting any more; the session opens without its {value!r}"
        for method, values in said.get("params", {}).items()
        for name, value in values.items()
        if value != _REMOVED.get(name, value)
    )


def _relative(value: Path, folder: Path) -> str:
    """Path relative to the session file, if at most three folders up, so that a folder can be
    moved as a whole.
    """
    full = os.path.abspath(value)  # noqa: PTH100 - resolve() would follow links
    relative = os.path.relpath(full, folder)
    return relative if relative.count("..") <= 3 else full


def _params(
    data: Mapping[str, Mapping[str, Plain]], path: Path, catalogue: Catalogue
) -> Mapping[str, object]:
    defaults: dict[str, object] = {DISPLAY_KEY: DisplayParams()}
    defaults |= {m.key: m.params() for stage in catalogue.stages for m in stage.methods}
    params: dict[str, object] = {}
    for key, values in data.items():
        where = f"params.{key}"
        if key not in defaults:
            raise FileProblem(f"{where} is not a method with parameters", path)
        params[key] = defaults[key]
        for name in sorted(values.keys() - _REMOVED.keys()):
            try:
                params[key] = replace_value(params[key], name, values[name])
            except SettingProblem as error:
                where = f"{where}.{name}"
                raise FileProblem(f"{where} cannot be used ({error})", path) from error
    return params
