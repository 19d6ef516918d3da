"""Reading tactoscope recordings: frame by frame as they are asked for; one damaged frame does not take the others."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import freeze
from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera, camera_from_matrix
from pipeline.geometry.meshes import Mesh
from pipeline.recordings import hdf5_layout as layout
from pipeline.recordings import hdf5_symmetry
from pipeline.recordings.indexing import checked_index
from pipeline.values.frames import Pairing, Recording, Stream, TactileFrame, Truth

T = TypeVar("T")

CUT_SHORT = "the file is cut short"


def read(path: Path) -> Recording:
    """A recording of ours, nothing but its tables of contents read yet; `close` it when done.

    A file that is cut short opens with a note, and frames beyond the cut raise FileProblem when asked for. Raises
    FileProblem when the file is no recording of ours, is newer than this program, or says no or a wrong unit.
    """
    notes: list[str] = []
    file = _opened(path, notes)
    try:
        return _recording(file, path, notes)
    except (FileProblem, CalibrationError):
        file.close()
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        file.close()
        raise FileProblem(f"the recording's table of contents is damaged ({_short(error)})", path) from error


def _recording(file: Any, path: Path, notes: list[str]) -> Recording:
    if file.attrs.get("format") != layout.FORMAT:
        raise FileProblem("this HDF5 file is not a tactoscope recording: its attribute 'format' is missing", path)
    version = int(file.attrs.get("format_version", 0))
    if not 1 <= version <= layout.VERSION:
        raise FileProblem(
            f"the recording has format version {version} and this program reads up to {layout.VERSION}; update it",
            path,
            field="format_version",
        )
    notes += [line for line in str(file.attrs.get("notes", "")).splitlines() if line]
    groups = sorted(file["streams"].items(), key=lambda item: int(item[1].attrs["order"]))
    streams = tuple(_stream(group, name, path, notes) for name, group in groups)
    if not streams:
        raise FileProblem("the recording has no streams", path, field="streams")
    mesh = _tolerated(lambda: _mesh(file["object"], path), None, "the object mesh", notes) if "object" in file else None
    symmetry = None
    if mesh is not None:
        symmetry = _tolerated(lambda: hdf5_symmetry.read(file["object"], path), None, "the object's symmetry", notes)
    pairings = tuple(_pairing(d, path) for d in file["pairings"].values()) if "pairings" in file else ()
    return Recording(path=path, format=layout.FORMAT, streams=streams, object_mesh=mesh, pairings=pairings,
                     notes=tuple(notes), close=file.close, symmetry=symmetry)  # fmt: skip


def _stream(group: Any, name: str, path: Path, notes: list[str]) -> Stream:
    frames = group["frames"]
    layout.checked_unit(frames, "rgb" if frames.ndim == 4 else "mm", path)
    layout.checked_unit(group["references"], "rgb" if frames.ndim == 4 else "mm", path)
    for key in ("timestamps", "reference_index", "truth/known", "truth/indentation", "truth/contact",
                "truth/sensor_from_object", "truth/force", "camera_matrix"):  # fmt: skip
        if key in group:
            layout.checked_unit(group[key], layout.UNITS[key], path)
    n, sensor = int(frames.shape[0]), str(group.attrs["sensor"])

    def table(key: str, lost: float, what: str) -> NDArray[Any]:
        return _tolerated(lambda: group[key][:n], np.full(n, lost, group[key].dtype), f"{what} of {name!r}", notes)

    times = table("timestamps", np.nan, "the timestamps")
    rows = table("reference_index", -1, "the table of references")
    known = table("truth/known", 0, "the table of what is known")
    camera = _camera(group, path) if "camera_matrix" in group else None

    def frame(index: int) -> TactileFrame:
        row = int(rows[index])
        return TactileFrame(
            sensor=sensor, image=_entry(group["frames"], index, index, name, path),
            reference=None if row < 0 else _entry(group["references"], row, index, name, path),
            index=index, time_s=float(times[index]), origin=f"{path} [{name}]", camera=camera,
        )  # fmt: skip

    def truth(index: int) -> Truth | None:
        bits = int(known[index])
        if not bits:
            return None

        def field(bit: int, key: str) -> Any:
            return _entry(group[key], index, index, name, path) if bits & bit else None

        contact = field(layout.KNOWN_CONTACT, "truth/contact")
        return Truth(indentation_mm=field(layout.KNOWN_INDENTATION, "truth/indentation"),
                     contact=None if contact is None else freeze(contact.astype(np.bool_)),
                     sensor_from_object=field(layout.KNOWN_POSE, "truth/sensor_from_object"),
                     force_n=field(layout.KNOWN_FORCE, "truth/force"))  # fmt: skip

    return Stream(name=name, sensor=sensor, n_frames=n, frame=checked_index(frame, n, path),
                  truth=checked_index(truth, n, path), has_truth=bool(known.any()))  # fmt: skip


def _entry(dataset: Any, row: int, index: int, stream: str, path: Path) -> NDArray[Any]:
    """One row, decoded; a chunk whose checksum fails names file, frame and field."""
    key = str(dataset.name).removeprefix(f"/streams/{stream}/")
    if row < dataset.shape[0]:
        try:
            return freeze(layout.decoded(dataset[row], dataset))
        except (OSError, RuntimeError):
            pass
    raise FileProblem(f"frame {index} of {stream!r}: its {key} are damaged or cut off; other frames can be read", path,
                      field=f"frame {index} {stream}/{key}")  # fmt: skip


def _camera(group: Any, path: Path) -> Camera:
    rows, cols = group["frames"].shape[1:3]
    key = f"{group.name}/camera_matrix".lstrip("/")
    try:
        return camera_from_matrix(group["camera_matrix"][()], rows, cols, what=key)
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{path}'") from error


def _mesh(group: Any, path: Path) -> Mesh:
    vertices = layout.checked_unit(group["vertices"], "mm", path)[()].astype(np.float64)
    triangles = layout.checked_unit(group["triangles"], "1", path)[()].astype(np.int32)
    return Mesh(vertices_mm=freeze(vertices), triangles=freeze(triangles), name=str(group.attrs.get("name", "")))


def _pairing(dataset: Any, path: Path) -> Pairing:
    layout.checked_unit(dataset, "mm", path)
    source, target = str(dataset.attrs["source"]), str(dataset.attrs["target"])
    matrix = rigid.checked(dataset[()], f"target_from_source of {source!r} and {target!r}")
    return Pairing(source=source, target=target, target_from_source=freeze(matrix))


def _tolerated(take: Callable[[], T], otherwise: T, what: str, notes: list[str]) -> T:
    """What `take` reads, or `otherwise` and a note when that part of the file is damaged."""
    try:
        return take()
    except (OSError, RuntimeError):
        notes.append(f"{what} cannot be read: that part of the file is damaged")
        return otherwise


def _opened(path: Path, notes: list[str]) -> Any:
    import h5py

    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "truncated file" not in str(error):
            raise FileProblem(f"the HDF5 file cannot be opened ({_short(error)})", path) from error
    data = path.read_bytes()
    try:
        whole = layout.whole_bytes(data)
        if whole > 100 * len(data) + (1 << 30):
            raise ValueError(f"{whole} bytes cannot be right")
        # The library refuses a file that ends early; with filling in place of the lost end it reads all that is there.
        # Not zeros: their checksum is zero, so that a lost chunk would pass for a good one.
        image = h5py.h5f.open_file_image(data + b"\xa5" * (whole - len(data)))
        file = h5py.File(image)
    except (OSError, ValueError, struct.error) as error:
        raise FileProblem("the HDF5 file is cut short before its table of contents", path) from error
    notes.append(f"{CUT_SHORT}: {len(data)} of {whole} bytes are there; frames beyond cannot be read")
    return file


def _short(error: Exception) -> str:
    """The library's reason without its preamble."""
    text = str(error)
    return text[text.find("(") + 1 :].rstrip(")") if "(" in text else text
