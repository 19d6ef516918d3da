"""The table of file formats that recordings are read from.

Readers, file dialogs and help texts are derived from `FORMATS`. Another package adds a format by
the entry point group `tactoscope.formats`, whose value is a `RecordingFormat`, or by
`register_format`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from pipeline.core.entry_points import call_package, load_entry_points, load_reference
from pipeline.core.errors import FileProblem
from pipeline.core.frozen import frozen

if TYPE_CHECKING:
    from pipeline.core.values.frames import Recording

T = TypeVar("T")

DepthUnit = Literal["auto", "mm", "m", "0.1mm", "um"]
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


@frozen
class RecordingFiles:
    """The files of one recording, as found at the path that the user gave."""

    path: Path  # a folder, or the one file
    format: str = ""  # key of the format, where the folder tells it; "" = decided by the file
    images: tuple[Path, ...] = ()  # image files in order
    references: tuple[Path, ...] = ()  # image files of the sensor without contact
    notes: tuple[str, ...] = ()  # what was chosen or left out
    # the recordings of the folder, where it holds several; the first is chosen
    alternatives: tuple[Path, ...] = ()


@frozen
class ReadOptions:
    """What the user states about a recording."""

    sensor: str = ""  # name or TOML file; "" = not stated
    # name of the stream that sensor and reference are about; "" = the format's choice
    stream: str = ""
    reference: Path | None = None  # image or depth file of the sensor without contact
    # frames of the recording to make the reference of (`reference_estimate`); "" = none
    reference_frames: str = ""
    depth_unit: DepthUnit = "auto"  # of depth arrays whose names state none


@frozen
class RecordingFormat:
    """One file format. A function given as "module:function" is imported on first use."""

    key: str
    title: str  # noun phrase for dialogs and messages
    # (Path) -> Recording; with `applies_options` (RecordingFiles, ReadOptions)
    reader: str | Callable[..., Any]
    suffixes: tuple[str, ...] = ()  # of its files, lower case; () = a folder only
    signatures: tuple[bytes, ...] = ()  # first bytes of a file, which count more than the suffix
    matches: str = ""  # (RecordingFiles) -> bool, among formats of one suffix; "" = always
    folder: str = ""  # (Path) -> bool: a folder is one recording of this format; "" = never
    # whether the reader applies sensor and reference itself; else it is done for it
    applies_options: bool = False

    def matches_files(self, files: RecordingFiles) -> bool:
        """Whether the content of `files` is of this format."""
        return not self.matches or self._ask(self.matches, files)

    def matches_folder(self, folder: Path) -> bool:
        """Whether `folder` is one recording of this format."""
        return bool(self.folder) and self._ask(self.folder, folder)

    def _ask(self, reference: str, of: RecordingFiles | Path) -> bool:
        """What a function says; no, where one of another package fails: it would refuse the
        files of other formats.
        """
        if self in FORMATS:
            return bool(load_reference(reference)(of))
        return call_package(
            lambda: bool(load_reference(reference)(of)), False, f"the format {self.key!r}"
        )

    def read(self, files: RecordingFiles, options: ReadOptions) -> Recording:
        """Open the recording; raises FileProblem, SettingProblem or CalibrationError."""
        read = load_reference(self.reader) if isinstance(self.reader, str) else self.reader
        return read(files, options) if self.applies_options else read(files.path)


_ZIP = b"PK\x03\x04"
_READERS = "pipeline.io"
_NOT_READ = (  # (first bytes, suffixes) of kinds of recordings that are not read -> what to do
    (
        (b"#ROSBAG",),
        (".bag",),
        "a ROS 1 bag is not read; run 'mcap convert FILE.bag FILE.mcap' and open the new file",
    ),
    (
        (b"SQLite format 3",),
        (".db3",),
        "a ROS 2 bag of SQLite is not read; run 'mcap convert FILE.db3 FILE.mcap' and "
        "open the new file",
    ),
    (
        (b"MATLAB",),
        (".mat",),
        "a MATLAB file is not read; save its images in Python: numpy.save('frames.npy', "
        "scipy.io.loadmat(FILE)[NAME])",
    ),
    ((), (".tfrecord",), "TFRecords (RLDS) are not read; save the tactile images with numpy.save"),
    (
        (),
        (".zip", ".tar", ".gz", ".tgz", ".7z", ".rar"),
        "an archive is not read; unpack it and open the folder",
    ),
    (
        (),
        (".zgroup", ".zarray", "zarr.json"),
        "a Zarr store is not read; save its images in Python: numpy.save('frames.npy', "
        "zarr.open(FOLDER)[NAME][:])",
    ),
    ((), (".rrd",), "a Rerun file is not read; open the recording that it was exported from"),
)
FORMATS = (  # of formats that share a suffix the first that matches is used
    RecordingFormat(
        key="robot_hdf5",
        title="robomimic or ACT data set",
        suffixes=(".h5", ".hdf5"),
        signatures=(b"\x89HDF\r\n\x1a\n",),
        applies_options=True,
        reader=f"{_READERS}.robot_data:read_hdf5",
        matches=f"{_READERS}.robot_data:is_robot_file",
    ),
    RecordingFormat(
        key="hdf5",
        title="Tactoscope recording",
        suffixes=(".h5", ".hdf5"),
        signatures=(b"\x89HDF\r\n\x1a\n",),
        reader=f"{_READERS}.hdf5:read",
    ),
    RecordingFormat(
        key="touch2touch",
        title="touch2touch grasps",
        suffixes=(".pt", ".pth"),
        signatures=(_ZIP,),
        reader=f"{_READERS}.touch2touch:read",
        matches=f"{_READERS}.touch2touch:is_grasp_file",
        folder=f"{_READERS}.grasp_files:is_grasp_folder",
    ),
    RecordingFormat(
        key="gelslim_depth",
        title="gelslim_depth dictionary",
        suffixes=(".pt", ".pth"),
        signatures=(_ZIP,),
        reader=f"{_READERS}.gelslim_depth:read",
        matches=f"{_READERS}.torch_files:is_torch_file",
    ),
    RecordingFormat(
        key="colour_arrays",
        title="Colour arrays",
        suffixes=(".npz", ".npy"),
        signatures=(b"\x93NUMPY", _ZIP),
        applies_options=True,
        reader=f"{_READERS}.colour_arrays:read",
        matches=f"{_READERS}.colour_arrays:is_colour_file",
    ),
    RecordingFormat(
        key="depth_arrays",
        title="Depth arrays",
        suffixes=(".npz", ".npy"),
        signatures=(b"\x93NUMPY", _ZIP),
        applies_options=True,
        reader=f"{_READERS}.depth_arrays:read",
    ),
    RecordingFormat(
        key="array_series",
        title="One array a frame",
        applies_options=True,
        reader=f"{_READERS}.colour_arrays:read_series",
    ),
    RecordingFormat(
        key="video",
        title="Video",
        suffixes=(".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"),
        applies_options=True,
        reader=f"{_READERS}.video:read",
    ),
    RecordingFormat(
        key="mcap",
        title="MCAP",
        suffixes=(".mcap",),
        signatures=(b"\x89MCAP0\r\n",),
        applies_options=True,
        reader=f"{_READERS}.mcap_images:read",
    ),
    RecordingFormat(
        key="lerobot",
        title="LeRobot data set",
        applies_options=True,
        reader=f"{_READERS}.lerobot:read",
        folder=f"{_READERS}.lerobot:is_data_set",
    ),
    RecordingFormat(
        key="tacquad",
        title="TacQuad touch",
        reader=f"{_READERS}.tacquad:read",
        folder=f"{_READERS}.tacquad:is_touch_folder",
    ),
    RecordingFormat(
        key="depth_images",
        title="16-bit depth images",
        suffixes=IMAGE_SUFFIXES,
        applies_options=True,
        reader=f"{_READERS}.depth_arrays:read_image_folder",
        matches=f"{_READERS}.depth_arrays:are_depth_images",
    ),
    RecordingFormat(
        key="images",
        title="Images",
        suffixes=IMAGE_SUFFIXES,
        applies_options=True,
        reader=f"{_READERS}.image_folder:read",
    ),
)
_registered: list[RecordingFormat] = []


def register_format(recording_format: RecordingFormat) -> None:
    """Add a format for this process.

    It is tried before those of the project. A later one of the same key wins.
    """
    _registered[:] = [f for f in _registered if f.key != recording_format.key]
    _registered.insert(0, recording_format)


def list_formats() -> tuple[RecordingFormat, ...]:
    """Every format in the order in which it is tried: registered, of other packages, of the
    project.
    """
    return (*_registered, *load_entry_points("tactoscope.formats", RecordingFormat), *FORMATS)


def explain_not_read(name: str, head: bytes) -> str:
    """What to do with a file of a known kind that is not read, by its name and first bytes.

    "" for another.
    """
    for marks, suffixes, text in _NOT_READ:
        if head.startswith(marks or (b"\0no signature",)) or any(
            f"{s}-" in f"{name.lower()}-" for s in suffixes
        ):
            return text
    return ""


def get_format(key: str) -> RecordingFormat:
    """The format of this key."""
    return next(f for f in list_formats() if f.key == key)


def list_suffixes() -> tuple[str, ...]:
    """The suffixes of all files that may be recordings, without images, each once."""
    suffixes = dict.fromkeys(suffix for f in list_formats() for suffix in f.suffixes)
    return tuple(s for s in suffixes if s not in IMAGE_SUFFIXES)


def make_dialog_filter() -> str:
    """The filter of a file dialog: all recordings, each format, all files."""
    kinds = {f"{f.title} ({_patterns(f.suffixes)})": None for f in list_formats() if f.suffixes}
    return ";;".join(
        [f"Recordings ({_patterns((*list_suffixes(), *IMAGE_SUFFIXES))})", *kinds, "All files (*)"]
    )


def describe_formats() -> str:
    """One line of all formats with their suffixes, for help and error messages."""
    return ", ".join(f"{f.title} ({' '.join(f.suffixes) or 'folder'})" for f in list_formats())


def _patterns(suffixes: tuple[str, ...]) -> str:
    return " ".join(f"*{suffix}" for suffix in suffixes)


def with_index_check(read: Callable[[int], T], n_frames: int, path: Path) -> Callable[[int], T]:
    """`read` that raises FileProblem for a number outside 0..n_frames-1."""

    def read_checked(index: int) -> T:
        if not 0 <= index < n_frames:
            last = f"frames are 0 to {n_frames - 1}" if n_frames else "it has no frames"
            raise FileProblem(f"there is no frame {index}, {last}", path)
        return read(index)

    return read_checked
