"""Open a recording of any format: the content of a file decides, then its suffix."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import FileProblem, SettingProblem, ShapeError, TouchError
from pipeline.core.files import close_on_error, describe_os_error, require_file
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io import depth_arrays, image_files, reference_estimate, reference_images
from pipeline.io.folder_contents import PICKLE_REFUSAL, PICKLE_SUFFIXES, find_recording
from pipeline.io.formats import (
    DepthUnit,
    ReadOptions,
    RecordingFiles,
    RecordingFormat,
    describe_formats,
    explain_not_read,
    get_format,
    list_formats,
)
from pipeline.io.mounts import open_mounted
from pipeline.sensors.spec import load_sensor

_HEAD_BYTES = 16  # enough for every signature
_MAX_NAMES = 3  # in a message


def open_recording(
    path: Path,
    *,
    sensor: str = "",
    stream: str = "",
    reference: Path | None = None,
    reference_frames: str = "",
    depth_unit: DepthUnit = "auto",
) -> Recording:
    """The recording at `path`, a file or a folder; frames are read on demand.

    `sensor` names the sensor where the file does not; it overrides the file's own name for the only
    stream, or for the one that `stream` names. `reference` is an image or depth file without
    contact; `reference_frames` names frames of the stream to make it of: "median", "untouched" or a
    number. `depth_unit` is the unit of depth arrays whose names state none. Raises FileProblem,
    SettingProblem or CalibrationError.
    """
    path = Path(path)
    options = ReadOptions(
        sensor=sensor,
        stream=stream,
        reference=reference,
        reference_frames=reference_frames,
        depth_unit=depth_unit,
    )
    if reference is not None and reference_frames:
        raise SettingProblem(
            "a reference is either a file or made of the recording's frames; leave out one of the "
            "two"
        )
    mounted = open_mounted(path)
    if mounted is not None:
        return _override(mounted, options)
    try:
        path.stat()
    except (OSError, ValueError) as error:
        reason = "" if isinstance(error, FileNotFoundError) else f" ({describe_os_error(error)})"
        raise FileProblem(f"no such file or folder{reason}", path) from error
    if reference is not None:
        require_file(reference, "the reference image")
    try:
        files = find_recording(path) if path.is_dir() else _single_file(path)
        recording_format = detect_format(files)
        recording = _read_alternative(recording_format, files, options)
    except OSError as error:
        raise FileProblem(
            f"cannot read the recording ({describe_os_error(error)})", path
        ) from error
    if not recording_format.applies_options:
        return _override(recording, options)
    return _use_own_frames(recording, options)


def _read_alternative(
    recording_format: RecordingFormat, files: RecordingFiles, options: ReadOptions
) -> Recording:
    """The recording, or the error of its reader, with what is known of its folder."""
    try:
        made = recording_format.read(files, options)
        notes = (*files.notes, *made.notes)
        return replace(made, notes=notes, alternatives=files.alternatives)
    except FileProblem as error:
        others = [file.name for file in files.alternatives[1:]]
        if others:
            error = error.extend(f"; or open {' or '.join(others[:_MAX_NAMES])} of the same folder")
        error.alternatives = files.alternatives
        raise error
    except TouchError as error:
        error.alternatives = files.alternatives
        raise


def detect_format(files: RecordingFiles) -> RecordingFormat:
    """The format of `files`; raises FileProblem where none fits."""
    if files.format:
        return get_format(files.format)
    path = files.images[0] if files.images else files.path
    suffix = path.suffix.lower()
    head = _read_head(path) if files.path.is_file() else b""
    if suffix in PICKLE_SUFFIXES:
        raise FileProblem(PICKLE_REFUSAL, path)
    not_read = explain_not_read(path.name, head) if head else ""
    if not_read:
        raise FileProblem(not_read, path)
    signed = [f for f in list_formats() if head.startswith(f.signatures or (b"\0no signature",))]
    named = [f for f in list_formats() if suffix in f.suffixes]
    candidates = [f for f in signed if f in named] or signed or named
    if not candidates:
        raise FileProblem(f"unknown kind of recording; known are {describe_formats()}", path)
    return next((f for f in candidates if f.matches_files(files)), candidates[-1])


def _single_file(path: Path) -> RecordingFiles:
    """One file; an image is a folder of one."""
    require_file(path, "the recording", most_bytes=1 << 50)
    return RecordingFiles(path=path, images=(path,) if image_files.is_image_file(path) else ())


def _read_head(path: Path) -> bytes:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        raise FileProblem("the file is empty", path)
    return head


def _override(recording: Recording, options: ReadOptions) -> Recording:
    """The recording with the stated sensor and reference."""
    with close_on_error(recording.close):
        recording = with_sensor(recording, options.sensor, options.stream)
        file = options.reference
        if file is None:
            return _use_own_frames(recording, options)
        image = (
            image_files.read_rgb(file)
            if image_files.is_image_file(file) and not depth_arrays.is_depth_image(file)
            else depth_arrays.read_depth_image(file, options.depth_unit)
        )
        return with_reference(recording, image, file, options.stream)


def _use_own_frames(recording: Recording, options: ReadOptions) -> Recording:
    """The recording with the reference of its own frames that the user chose, for the stream of
    the user's choice.
    """
    if not options.reference_frames:
        return recording
    with close_on_error(recording.close):
        stream = recording.stream(
            options.stream or (load_sensor(options.sensor).name if options.sensor else "")
        )
        reference, note = reference_estimate.make_reference(
            stream, options.reference_frames, recording.path
        )
    kept = tuple(
        note
        for note in recording.notes
        if not note.endswith(image_files.NO_REFERENCE_NOTE) and reference_images.TAKEN not in note
    )
    return _replace_reference(
        replace(recording, notes=kept), stream, reference, f"{note}, as chosen"
    )


def with_sensor(recording: Recording, sensor: str, stream: str = "") -> Recording:
    """The recording with `sensor` as the sensor of its only stream, or of the one that `stream`
    names.

    Else of the only stream that does not name its sensor, or of those of them that have its image
    size.
    """
    if not sensor:
        return recording
    spec = load_sensor(sensor)
    name = spec.name
    asked = [s for s in recording.streams if s.name == stream]
    meant = asked or (list(recording.streams) if len(recording.streams) == 1 else [])
    if not meant:
        meant = [s for s in recording.streams if not s.sensor]
        if len(meant) > 1:
            shape = spec.camera.shape
            meant = [s for s in meant if s.n_frames and s.frame(0).image.shape[:2] == shape]
    streams = tuple(
        replace(_map_frames(s, lambda frame: replace(frame, sensor=name)), sensor=name)
        if s in meant
        else s
        for s in recording.streams
    )
    replaced = [s.sensor for s in meant if s.sensor not in ("", name)]
    note = (f"the file names the sensor {replaced[0]}; {name} is used instead",) if replaced else ()
    return replace(recording, streams=streams, notes=recording.notes + note)


def with_reference(
    recording: Recording, reference: Image | Floats, origin: Path, stream: str = ""
) -> Recording:
    """The recording with another reference for its only stream, or for the one that `stream` names.

    Raises SettingProblem for several streams of which none is named.
    """
    if len(recording.streams) != 1 and not stream:
        raise SettingProblem(
            "a reference can be given for one stream, this recording has "
            f"{len(recording.streams)}; choose it with "
            f"--stream: '{origin}'"
        )
    return _replace_reference(
        recording, recording.stream(stream), reference, f"{origin.name} is the reference", origin
    )


def _replace_reference(
    recording: Recording,
    changed: Stream,
    reference: Image | Floats,
    note: str,
    origin: Path | None = None,
) -> Recording:
    def replace_reference(frame: TactileFrame) -> TactileFrame:
        if frame.image.shape != reference.shape:
            raise ShapeError(
                f"the reference has shape {reference.shape} and frame {frame.index} "
                f"{frame.image.shape}: "
                f"'{origin or recording.path}'"
            )
        return replace(frame, reference=reference)

    streams = tuple(
        _map_frames(s, replace_reference) if s is changed else s for s in recording.streams
    )
    refresh = recording.refresh

    def refresh_with_reference() -> Recording:
        assert refresh is not None
        grown = refresh()
        return _replace_reference(grown, grown.stream(changed.name), reference, note, origin)

    return replace(
        recording,
        streams=streams,
        notes=(*recording.notes, note),
        refresh=None if refresh is None else refresh_with_reference,
    )


def _map_frames(stream: Stream, change: Callable[[TactileFrame], TactileFrame]) -> Stream:
    def frame(index: int) -> TactileFrame:
        return change(stream.frame(index))

    return replace(stream, frame=frame)
