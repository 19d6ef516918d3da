"""Repro bundle: a folder with one frame, all that its translation reads, and its results.

bundle.json      request with paths within the folder, metrics, a note, the command that replays it
frame.h5         the frame of both sensors with ground truth, the object and the alignment; then the
context frames
                 that the illumination of the sensor instance is estimated from
alignment.toml   the alignment in use, with offsets
expected.npz     every array of every stage
sheet.png        the same as an image
calibration.npz, weights_*, source.toml, target.toml   where they were given as files
"""

import shlex
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pipeline import __version__
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import (
    read_arrays,
    read_json,
    write_arrays,
    write_folder,
    write_json,
)
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResults
from pipeline.core.progress import SILENT, Progress
from pipeline.core.typed_data import FileName, Name, Note, convert
from pipeline.core.values.frames import TactileFrame
from pipeline.io.formats import DepthUnit
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.sensors.alignment import AlignmentFile, Offsets, save_alignment
from pipeline.translation.frame_selection import select_context_frames
from pipeline.translation.reports.export_request import format_options
from pipeline.translation.reports.report import collect_stage_arrays
from pipeline.translation.reports.sheet import write_sheet
from pipeline.translation.translate import Request, Translation, open_translation
from pipeline.translation.translated_frame import FrameReport

REPLAY_TOLERANCE = 1e-4  # share of an array's own range: rounding of another processor
_VERSION = 1
_CACHE_BYTES = 64 * 1024 * 1024  # one frame's stages
_VERSION_KEY = "tactoscope bundle"
_WORDS = ("source", "target", "stream", "route", "mesh_unit", "depth_unit")
_FILES = ("recording", "mesh", "calibration", "alignment")


class _RequestFile(msgspec.Struct):
    source: Name
    target: Name
    stream: Name
    route: Name
    mesh_unit: Name
    depth_unit: DepthUnit
    recording: FileName
    mesh: FileName | None = None
    calibration: FileName | None = None
    alignment: FileName | None = None
    methods: dict[Name, Name] = {}
    weights: dict[Name, FileName] = {}


class _BundleFile(msgspec.Struct):
    """What is read of `bundle.json`."""

    request: _RequestFile
    settings: tuple[Name, ...]
    note: Note = ""
    metrics: dict[Name, float | None] = {}


@frozen
class StageAgreement:
    """Agreement of one stage of a replayed bundle with the recorded result."""

    stage: str
    n_arrays: int
    largest_difference: (
        # difference, as a share of the array's own range; 0 = the same bytes, inf = another shape
        float
    )
    worst_array: str  # that differs most


@frozen
class ReplayResult:
    """Result of a replayed bundle."""

    note: str
    agreements: tuple[StageAgreement, ...]
    metrics: Mapping[str, float]
    expected_metrics: Mapping[str, float]

    @property
    def is_same(self) -> bool:
        """Whether all results are the same but for rounding."""
        return all(
            agreement.largest_difference <= REPLAY_TOLERANCE for agreement in self.agreements
        )


def write_bundle(
    request: Request,
    settings: tuple[str, ...],
    frame: int,
    folder: Path,
    *,
    note: str = "",
    progress: Progress = SILENT,
) -> None:
    """Write the repro bundle of one frame into a new `folder`; raises TouchError."""
    if folder.exists():
        raise FileProblem(
            "something of this name is there already and is kept; choose another", folder
        )
    with open_translation(request) as translation:
        index = translation.check_index(frame)

        def fill(part: Path) -> None:
            inside = _copy_inputs(translation, part)
            _record(translation, index, part / "frame.h5")
            values: dict[str, object] = {
                **{name: getattr(inside, name) for name in _WORDS},
                **{name: getattr(getattr(inside, name), "name", None) for name in _FILES},
                "methods": dict(inside.methods),
                "weights": {stage: file.name for stage, file in inside.weights},
            }
            metrics = _write_results(part, inside, settings, index, progress)
            write_json(
                part / "bundle.json",
                {
                    _VERSION_KEY: _VERSION,
                    "made with": __version__,
                    "note": note,
                    "frame": index,
                    "of": str(request.recording),
                    "command": shlex.join(["tactoscope", "replay", str(folder.absolute())]),
                    "translate": _translating(inside, settings),
                    "request": values,
                    "settings": list(settings),
                    "metrics": metrics,
                },
                "the repro bundle",
                lambda written: _read(written.parent),
            )

        write_folder(folder, fill)


def replay_bundle(folder: Path, progress: Progress = SILENT) -> ReplayResult:
    """Translate a bundle's frame again and compare it with the recorded results.

    Raises TouchError.
    """
    said = _read(folder)
    request = _request(said.request, folder)
    try:
        opened = _open(request, said.settings)
    except SettingProblem as error:
        raise FileProblem(
            f'the bundle cannot be opened ({error}); take that out of its "request" or '
            '"settings", or replay it with the program that wrote it',
            folder / "bundle.json",
        ) from error
    with opened as translation:
        frame, results, metrics = _translate(translation, progress)
    now = collect_stage_arrays(frame, results)
    kept = read_arrays(folder / "expected.npz", "the expected results")
    stages = dict.fromkeys(name.partition(".")[0] for name in (*kept, *now))
    return ReplayResult(
        note=said.note,
        metrics=metrics,
        expected_metrics={k: float("nan") if v is None else v for k, v in said.metrics.items()},
        agreements=tuple(_agreement(stage, now, kept) for stage in stages),
    )


def _write_results(
    part: Path, inside: Request, settings: tuple[str, ...], index: int, progress: Progress
) -> dict[str, float]:
    """Translate the copied frame, write what was computed.

    Returns the metrics.

    `index` is the frame's number in the recording, by which the sheets name it.
    """
    with _open(inside, settings) as translation:
        frame, results, metrics = _translate(translation, progress)
        write_arrays(part / "expected.npz", collect_stage_arrays(frame, results))
        report = FrameReport(index=index, results=results, metrics=metrics)
        write_sheet(part / "sheet.png", frame, report, translation)
        return metrics


def _open(request: Request, settings: tuple[str, ...]) -> Translation:
    """Open a bundle's translation; settings of the display change no result."""
    return open_translation(request, settings=_of_stages(settings), cache_bytes=_CACHE_BYTES)


def _of_stages(settings: tuple[str, ...]) -> list[str]:
    return [line for line in settings if not line.startswith("display.")]


def _translate(
    translation: Translation, progress: Progress
) -> tuple[TactileFrame, StageResults, dict[str, float]]:
    results = translation.evaluate(0, progress=progress)
    return translation.stream.frame(0), results, translation.compute_metrics(results, 0)


def _copy_inputs(translation: Translation, part: Path) -> Request:
    """Copy all input files into the folder; returns the request of the copies."""
    request = translation.request
    source = translation.source.name
    target = translation.target.name
    aligned = AlignmentFile(
        alignment=translation.alignment,
        source=source,
        target=target,
        origin=f"in use on {request.recording.name} when the bundle was written",
    )
    save_alignment(part / "alignment.toml", aligned)
    weights = tuple(
        (stage, _copy(file, part / f"weights_{stage}{file.suffix}"))
        for stage, file in request.weights
    )
    return replace(
        request,
        recording=part / "frame.h5",
        reference=None,
        reference_frames="",
        alignment=part / "alignment.toml",
        offsets=Offsets(),
        source=_sensor(request.source or source, part / "source.toml"),
        target=_sensor(request.target or target, part / "target.toml"),
        stream=translation.stream.name,
        mesh=None,  # it is in the recording
        calibration=None
        if request.calibration is None
        else _copy(request.calibration, part / "calibration.npz"),
        weights=weights,
    )


def _sensor(said: str, place: Path) -> str:
    """Return a sensor's name, or the copy of its description."""
    return said if not said.endswith(".toml") else str(_copy(Path(said), place))


def _copy(file: Path, place: Path) -> Path:
    shutil.copyfile(file, place)
    return place


def _record(translation: Translation, index: int, path: Path) -> None:
    """Write the frame of both sensors with ground truth, and its context frames."""
    recording = translation.recording
    stream = translation.stream
    other = recording.find_partner(stream.name, translation.target.name)
    names = {stream.name, *(() if other is None else (other.name,))}
    pairings = [pair for pair in recording.pairings if {pair.source, pair.target} <= names]
    with RecordingWriter(
        path,
        object_mesh=translation.mesh,
        symmetry=translation.symmetry,
        pairings=pairings,
        notes=recording.notes,
    ) as writer:
        reference = stream.frame(index).reference
        context = (
            select_context_frames(stream) if translation.load_context_images(reference) else ()
        )
        is_observed = False
        for place, k in enumerate(dict.fromkeys((index, *(frame.index for frame in context)))):
            source_frame = replace(stream.frame(k), sensor=translation.source.name, index=place)
            writer.append(stream.name, source_frame, stream.truth(k))
            observed = translation.read_target_observation(k)
            # else a later one would be the first
            is_observed = observed is not None and (place == 0 or is_observed)
            if is_observed and observed is not None and other is not None:
                writer.append(other.name, replace(observed[0], index=place), observed[1])


def _translating(request: Request, settings: tuple[str, ...]) -> str:
    """Return the command that translates the frame within the folder."""
    words = [
        word.removeprefix(str(request.recording.parent.absolute()) + "/")
        for word in format_options(request)
    ]
    sets = [word for line in _of_stages(settings) for word in ("--set", line)]
    return shlex.join(["tactoscope", "translate", *words, *sets, "--frame", "0", "--out", "out"])


def _agreement(
    stage: str, now: Mapping[str, NDArray[Any]], kept: Mapping[str, NDArray[Any]]
) -> StageAgreement:
    names = sorted(name for name in {*now, *kept} if name.partition(".")[0] == stage)
    gaps = {name: _gap(now.get(name), kept.get(name)) for name in names}
    worst = max(gaps, key=gaps.__getitem__)
    return StageAgreement(
        stage=stage, n_arrays=len(names), largest_difference=gaps[worst], worst_array=worst
    )


def _gap(now: NDArray[Any] | None, kept: NDArray[Any] | None) -> float:
    """Return the largest difference as a share of the recorded range.

    Of masks and indices the share that changed.
    """
    if now is None or kept is None or now.shape != kept.shape or now.dtype != kept.dtype:
        return float("inf")
    if now.dtype.kind != "f" or not kept.size:
        return float((now != kept).mean()) if kept.size else 0.0
    if np.array_equal(now, kept, equal_nan=True):
        return 0.0
    if not np.array_equal(np.isnan(now), np.isnan(kept)):
        return float("inf")
    spread = float(np.nanmax(kept) - np.nanmin(kept)) or max(1.0, float(np.nanmax(np.abs(kept))))
    return float(np.nanmax(np.abs(now.astype(np.float64) - kept))) / spread


def _read(folder: Path) -> _BundleFile:
    path = folder / "bundle.json"
    said: Any = read_json(path, "the repro bundle")
    if not isinstance(said, dict) or _VERSION_KEY not in said:
        raise FileProblem(
            "this folder holds no repro bundle; `tactoscope bundle` writes one", folder
        )
    version: Any = said[_VERSION_KEY]
    if version != _VERSION:
        raise FileProblem(
            f"the repro bundle has version {version!r}, this program reads {_VERSION}", path
        )
    return convert(said, _BundleFile, "the repro bundle", path)


def _request(asked: _RequestFile, folder: Path) -> Request:
    def inside(name: str) -> Path:
        return folder / Path(name).name

    given: dict[str, Any] = {name: getattr(asked, name) for name in (*_WORDS, *_FILES)}
    for name in _FILES:
        given[name] = None if given[name] is None else inside(given[name])
    for side in ("source", "target"):
        if given[side].endswith(".toml"):
            given[side] = str(inside(given[side]))
    return Request(
        **given,
        methods=tuple(asked.methods.items()),
        weights=tuple((stage, inside(name)) for stage, name in asked.weights.items()),
    )
