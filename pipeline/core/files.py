"""Write files atomically, and read only regular files.

Files are written under a temporary name in the same folder, flushed to disk, read back and then
renamed: what cannot be opened again replaces nothing. A few bytes can state, or unfold to,
gigabytes: every reader compares what a file states with `require_budget` before reading.
"""

import contextlib
import errno
import fcntl
import hashlib
import itertools
import json
import os
import platform
import shutil
import stat
import tempfile
import tomllib
import uuid
import zipfile
import zlib
from collections.abc import Callable, Collection, Generator, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pipeline.core.errors import FileProblem, TouchError

FileReader = Callable[[Path], object]  # raises TouchError for a file that it cannot read

MOST_BYTES = 2 << 30  # of one image or mesh
_MOST_HELD_BYTES = 1 << 30  # of what is held in memory at once of one file, unfolded
MOST_NETWORK_BYTES = 1_400_000_000  # of a network's numbers; the largest that is known takes 1.3 GB
MOST_TEXT_BYTES = 16 << 20  # of a description, an alignment or a session, which are a few kB
_POINTER_START = b"version https://git-lfs"
_DESCRIPTION = (
    "the sensor description",
    "the description of a sensor, to be given as --sensor or --target",
)
_TOML_FILES = {  # a key that only such a file has -> what reads it, and what a user does with it
    "alignment_from_source": (
        "the alignment",
        "an alignment, to be given as --alignment or dropped on the window",
    ),
    "kind": _DESCRIPTION,
    "extends": _DESCRIPTION,
    "task": (
        "the recipe",
        "the recipe of a training, to be given to 'tactoscope train' as --recipe",
    ),
    "depth_mm": ("the task", "a tool for insertion, to be given to 'tactoscope task'"),
}
# of an array that tell whether it is worth compressing: as many on both sides of its middle, and
# the share of them above which it is stored as it is
_SAMPLE_BYTES = 1024
_SHRUNK_SHARE = 0.3  # an index of every pixel is above it, and took a quarter of a frame's writing
# of files, which no folder of results is meant to have
_FILE_SUFFIXES = (".csv", ".h5", ".json", ".mcap", ".mp4", ".npz", ".pdf", ".ply", ".png", ".rrd")
_MAX_TRIES = 10  # of making or replacing a folder while other processes do


@contextlib.contextmanager
def name_os_error(problem: str, path: Path) -> Generator[None, None, None]:
    """Raise FileProblem, with `problem` and the system's reason, for an OSError of the block."""
    try:
        yield
    except OSError as error:
        raise FileProblem(f"{problem} ({describe_os_error(error)})", path) from error


@contextlib.contextmanager
def close_on_error(close: Callable[[], object]) -> Generator[None]:
    """Call `close` where the block raises."""
    with contextlib.ExitStack() as on_error:
        on_error.callback(close)
        yield
        on_error.pop_all()


@contextlib.contextmanager
def open_atomic(path: Path, what: str, read: FileReader | None) -> Generator[BinaryIO, None, None]:
    """Yield a temporary file that replaces `path` when the block succeeds and is removed otherwise.

    `read` is the program's reader of such files, which must accept what was written; None where
    there is none. A link stays a link to the new file, and a replaced file leaves its permissions.
    Raises FileProblem "cannot write `what`" with the system's reason, also for an OSError of the
    block itself, and where `path` is no regular file.
    """
    place = Path(os.path.realpath(path))
    part = place.with_name(_name_part())
    if place.exists() and not place.is_file():
        raise FileProblem(f"cannot write {what} (a folder or a device of this name is there)", path)
    _check_unprotected(path)
    with name_os_error(f"cannot write {what}", path):
        _remove_leftovers(place.parent)
        with _create_part(part), (part / place.name).open("w+b") as file:
            if place.exists():
                os.fchmod(file.fileno(), stat.S_IMODE(place.stat().st_mode))
            yield file
            file.flush()
            os.fsync(file.fileno())
            if read is not None:
                read_back(part / place.name, path, what, read)
            (part / place.name).replace(place)


def read_back(written: Path, path: Path, what: str, read: FileReader) -> None:
    """Read what was `written` to be moved to `path`; raises FileProblem where that fails."""
    try:
        read(written)
    except TouchError as error:
        reason = str(error).replace(f": '{written}'", "")
        raise FileProblem(
            f"{what} cannot be read back as it was written ({reason})", path
        ) from error


def write_folder(folder: Path, fill: Callable[[Path], None], own: Collection[str] = ()) -> None:
    """Have `fill` write into a new folder that replaces `folder` once it is complete.

    What is there is replaced only if it is empty or holds `own[0]` and nothing but files named in
    `own`. Raises FileProblem.
    """
    part, before = (folder.with_name(_name_part()) for _ in range(2))
    require_own(folder, own)
    try:
        with name_os_error("cannot write the results", folder):
            _remove_leftovers(folder.parent)
            with _create_part(part):
                fill(part)
                require_own(folder, own)
                _replace_folder(part, folder, before)
    except FileProblem as error:
        raise error.relocate(folder, instead_of=part) from error
    finally:
        _remove(before)


def require_own(folder: Path, own: Collection[str]) -> None:
    """Raise FileProblem where `folder` is a file, or holds files that this program did not write
    there.
    """
    if folder.is_file():
        raise FileProblem("this is a file, not a folder; choose another name", folder)
    found = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set[str]()
    foreign = sorted(found - set(own)) or (
        [] if not found or next(iter(own), "") in found else sorted(found)
    )
    if foreign:
        raise FileProblem(
            f"this folder holds other files ({foreign[0]!r}) that would be lost; move them or "
            "choose another folder",
            folder,
        )


def require_separate(out: Path, inputs: Iterable[Path]) -> None:
    """Raise FileProblem if writing `out` would replace one of `inputs`, or a file in a folder
    among them.
    """
    for path in inputs:
        with contextlib.suppress(OSError, ValueError):  # what does not exist is not replaced
            is_same = out.samefile(path)
            is_part = (
                path.is_dir() and out.is_file() and out.resolve().is_relative_to(path.resolve())
            )
            if is_same or is_part:
                raise FileProblem("this would replace what is read; choose another output", out)


def _name_part() -> str:
    """Return a new name that no other process, container or machine gives to its temporary
    files.
    """
    return f".tactoscope-{_get_boot()}-{uuid.uuid4().hex}.part"


def _get_boot() -> str:
    """Return a digest of this machine's name and start: the locks of its processes can be seen
    from here.
    """
    boot = f"{platform.node()} {uuid.getnode()}"
    with contextlib.suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
    return hashlib.sha256(boot.encode()).hexdigest()[:12]


@contextlib.contextmanager
def _create_part(part: Path) -> Generator[None, None, None]:
    """Make a new folder that lasts as long as the context, locked against other processes where
    the system can.
    """
    missing = [folder for folder in part.parents if not folder.exists()]
    descriptor = _lock_new_folder(part)
    try:
        yield
    finally:
        os.close(descriptor)
        _remove(part)
        with contextlib.suppress(OSError):  # something was written
            for folder in missing:
                folder.rmdir()


def _lock_new_folder(part: Path) -> int:
    """The descriptor of a new locked folder.

    Another process may take it for a leftover until it is locked.
    """
    for _ in range(_MAX_TRIES):
        part.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(part, os.O_RDONLY | os.O_CLOEXEC)
            with contextlib.suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), part.stat()):
                    return descriptor
            os.close(descriptor)
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), os.fspath(part))


def _replace_folder(part: Path, folder: Path, before: Path) -> None:
    """Rename `part` to `folder`, and `folder` to `before`.

    Safe against other processes doing the same.
    """
    for _ in range(_MAX_TRIES):
        with contextlib.suppress(FileNotFoundError):
            folder.replace(before)
        try:
            part.replace(folder)
            return
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            _remove(before)
    part.replace(folder)


def check_folder(folder: Path) -> None:
    """Make sure that `folder` is writable or can be made, before long work.

    Nothing is left where that work fails.

    Raises FileProblem otherwise, and for the name of a file.
    """
    if folder.suffix.lower() in _FILE_SUFFIXES and not folder.exists():
        raise FileProblem(
            f"the results are a folder, which does not end in {folder.suffix}; leave that out, or "
            "write one file by 'tactoscope export'",
            folder,
        )
    try:
        with tempfile.TemporaryDirectory(prefix=".ready", dir=_find_existing(folder.absolute())):
            pass
    except OSError as error:
        raise FileProblem(
            f"this folder is not writable ({describe_os_error(error)}); choose another place",
            folder,
        ) from error


def _find_existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists.

    Raises OSError for a name that the file system refuses.
    """
    for place in (folder, *folder.parents):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            os.lstat(place)
            return place
    return folder


def check_folder_for(path: Path) -> None:
    """Make sure that the file `path` can be written, before long work."""
    if path.is_dir():
        raise FileProblem("this is a folder, not a file; choose another name", path)
    _check_unprotected(path)
    check_folder(path.parent)


def _check_unprotected(path: Path) -> None:
    """Refuse to replace a file that the user may not write, which the system would allow."""
    if path.exists() and not os.access(path, os.W_OK):
        raise FileProblem("this file is write-protected; choose another name", path)


@contextlib.contextmanager
def open_growing_file(path: Path, what: str) -> Generator[BinaryIO, None, None]:
    """Yield a new file in its final place, to be read while it grows.

    The writer keeps it valid at every moment. Raises FileProblem, also for an OSError of the block
    itself.
    """
    with name_os_error(f"cannot write {what}", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w+b") as file:
            yield file


def open_lock(path: Path) -> BinaryIO:
    """Open an empty file, locked against other processes until it is closed or this process ends.

    Raises FileProblem.
    """
    with name_os_error("cannot lock this file", path):
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.open("wb")
        with close_on_error(lock.close):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return lock


def set_aside(path: Path) -> Path:
    """Rename the file at `path` so that a new one does not overwrite it; returns the new path."""
    aside = next(
        place
        for n in itertools.count()
        if not (place := path.with_name(f"{path.name}.unread{n or ''}")).exists()
    )
    with name_os_error("cannot put this file aside", path):
        return path.rename(aside)


def write_text(path: Path, text: str, what: str, read: FileReader | None) -> None:
    """Write `text` as UTF-8 atomically and read it back (see `open_atomic`); raises FileProblem."""
    with open_atomic(path, what, read) as file:
        file.write(text.encode("utf-8"))


def write_together(
    folder: Path, contents: Mapping[str, bytes], what: str, read: FileReader
) -> None:
    """Write several files of a folder: all of them are replaced, or none where one cannot be
    written or read back.

    `read` reads the folder. Raises FileProblem.
    """
    part = folder / _name_part()
    with name_os_error(f"cannot write {what}", folder), _create_part(part):
        for name, content in contents.items():
            (part / name).write_bytes(content)
        read_back(part, folder, what, read)
    with contextlib.ExitStack() as stack:
        for name, content in contents.items():
            file = stack.enter_context(open_atomic(folder / name, what, None))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # a full disk shows here, before the first file is replaced


def write_json(
    path: Path, value: object, what: str = "the report", read: FileReader | None = None
) -> None:
    """Write `value` as indented JSON; numbers that are not finite become null.

    `read` None: no command of ours reads it, and it must be JSON.
    """
    write_text(
        path,
        format_json(value),
        what,
        read or (lambda written: _parse(written, what, json.loads, "JSON", MOST_BYTES)),
    )


def format_json(value: object) -> str:
    """Return `value` as indented JSON; numbers that are not finite become null."""
    return json.dumps(_to_json(value), indent=1, allow_nan=False) + "\n"


def write_arrays(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    what: str = "the arrays",
    read: FileReader | None = None,
) -> None:
    """Write `arrays` as one .npz without pickle, lightly compressed where that saves space.

    `read` None: they must be readable as arrays.
    """
    with (
        open_atomic(path, what, read or (lambda written: read_arrays(written, what))) as file,
        zipfile.ZipFile(file, "w", compresslevel=1) as archive,
    ):
        for name, array in arrays.items():
            archive.compression = _choose_compression(array)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asanyarray(array), allow_pickle=False)


def _choose_compression(array: NDArray[Any]) -> int:
    """Return how a zip file holds an array: as it is where it is small, or where its middle hardly
    shrinks, as measured values do, which would cost ten times the time.
    """
    flat = np.ravel(array)
    if flat.nbytes < _SAMPLE_BYTES:
        return zipfile.ZIP_STORED
    reach = _SAMPLE_BYTES // flat.itemsize
    middle = flat[max(0, flat.size // 2 - reach) : flat.size // 2 + reach].tobytes()
    shrinks = len(zlib.compress(middle, 1)) < _SHRUNK_SHARE * len(middle)
    return zipfile.ZIP_DEFLATED if shrinks else zipfile.ZIP_STORED


def read_arrays(path: Path, what: str) -> dict[str, NDArray[Any]]:
    """Read every array of an .npz by its key, or the memory-mapped array of an .npy by its file's
    stem.

    Raises FileProblem for damaged files, and for pickled objects, which could run code.
    """
    require_file(path, what, most_bytes=1 << 50)
    try:
        with path.open("rb") as file:
            if file.read(6) == b"\x93NUMPY":
                return {path.stem: np.load(path, allow_pickle=False, mmap_mode="r")}
            with zipfile.ZipFile(file) as archive:
                n_bytes = sum(entry.file_size for entry in archive.infolist())
            require_budget(n_bytes, what, path)
            file.seek(0)
            opened: Any = np.load(file, allow_pickle=False)
            return {key: opened[key] for key in opened.files}
    except FileProblem:
        raise
    except Exception as error:  # zip and zlib errors have no common root
        if any(
            words in str(error) for words in ("allow_pickle", "Object arrays", "Python objects")
        ):
            raise FileProblem(
                f"loading {what} could run code: the file holds pickled objects; in the program "
                "that made it, save "
                "them as plain arrays with numpy.savez",
                path,
            ) from error
        raise FileProblem(
            f"{what} cannot be read: the file is cut short or damaged, or no .npz", path
        ) from error


def read_cached_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """Read every array of an .npz in a cache; None where the file is missing or damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as opened:
            return {key: opened[key] for key in opened.files}
    except Exception:  # noqa: BLE001 - errors of zip, zlib and numpy's headers have no common root
        return None


def require_file(path: Path, what: str, most_bytes: int = MOST_BYTES) -> None:
    """Raise FileProblem unless `path` is a regular file of at most `most_bytes`.

    Reading a pipe could block forever.
    """
    try:
        found = path.stat()
    except (OSError, ValueError) as error:
        raise FileProblem(f"cannot read {what} ({describe_os_error(error)})", path) from error
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device"
        raise FileProblem(f"cannot read {what} (this is {kind}, not a file)", path)
    if found.st_size > most_bytes:
        raise FileProblem(f"cannot read {what} ({found.st_size:.3g} bytes is too large)", path)
    # who reads the file says why it cannot be read
    with contextlib.suppress(OSError), path.open("rb") as file:
        if file.read(len(_POINTER_START)) == _POINTER_START:
            raise FileProblem(
                f"this is the Git LFS pointer of {what}; fetch the content by 'git lfs pull'", path
            )


def read_bytes(path: Path, what: str, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Raises FileProblem "cannot read `what`" with the reason.
    """
    require_file(path, what, most_bytes)
    with name_os_error(f"cannot read {what}", path):
        return path.read_bytes()


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Raises FileProblem, also for excessive nesting and a file of another use.
    """
    tables = _parse(path, what, tomllib.loads, "TOML")
    for key, (reader, use) in _TOML_FILES.items():
        if key in tables and reader != what:
            raise FileProblem(f"cannot read {what}: this file is {use}", path)
    return tables


def read_json(path: Path, what: str) -> Any:
    """Return the value of a JSON file; raises FileProblem, also for excessive nesting."""
    return _parse(path, what, json.loads, "JSON")


def _parse(
    path: Path,
    what: str,
    parse: Callable[[str], Any],
    language: str,
    most_bytes: int = MOST_TEXT_BYTES,
) -> Any:
    try:
        # editors of Windows mark UTF-8
        return parse(read_bytes(path, what, most_bytes).decode("utf-8-sig"))
    # both languages' own errors, and that of UTF-8, are ValueErrors
    except (ValueError, RecursionError) as error:
        raise FileProblem(f"{what} is not valid {language} ({error})", path) from error


def describe_os_error(error: Exception) -> str:
    """Return the system's reason for an error; the HDF5 library wraps it in a long text."""
    number = error.errno if isinstance(error, OSError) else None
    return os.strerror(number) if number else str(error).partition("\n")[0]


def _remove_leftovers(folder: Path) -> None:
    """Remove temporary files of processes of this machine that were killed: their locks are
    free.
    """
    for rest in folder.glob(f".tactoscope-{_get_boot()}-*.part"):
        with contextlib.suppress(OSError):  # being written, another user's, or gone
            descriptor = os.open(rest, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # its owner may have made it anew under the same name since it was opened
                if os.path.samestat(os.fstat(descriptor), rest.stat()):
                    _remove(rest)
            finally:
                os.close(descriptor)


def _remove(path: Path) -> None:
    """Remove a file or a folder, as far as possible."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def _to_json(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(k): _to_json(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_json(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def require_budget(n_bytes: int, what: str, path: Path, *, most: int = _MOST_HELD_BYTES) -> None:
    """Raise FileProblem where `what`, which the file states to unfold to `n_bytes`, is beyond
    the budget.
    """
    if n_bytes > most:
        raise FileProblem(
            f"{what} would take {n_bytes / 1e9:.1f} GB of memory, more than the {most / 1e9:.1f} "
            "GB that a file may; "
            "it is damaged, or has to be split",
            path,
        )
