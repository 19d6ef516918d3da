"""File dialogs, and what a path is."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

from PyQt6.QtWidgets import QFileDialog, QWidget

from app.session.state import SUFFIX

ALIGNMENT = ".toml"
MESHES = (".stl", ".obj", ".ply")
_UNITS = {
    "auto": "Meshes, in mm if that can be",
    "mm": "Meshes in millimetres",
    "cm": "Meshes in centimetres",
    "m": "Meshes in metres",
}


def is_calibration(path: Path) -> bool:
    """Whether a file is a look-up made by `tactoscope calibrate`, told from other archives by what it holds."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            held = set(archive.namelist())
            return {"coefficients.npy", "slope_max.npy"} <= held
    except (OSError, zipfile.BadZipFile):
        return False


def recording(parent: QWidget) -> Path | None:
    """Ask for a recording."""
    return _open(parent, "Open recording", "Recordings (*.h5 *.hdf5 *.pt *.npz *.mp4 *.avi *.mov *.mkv);;All files (*)")


def folder(parent: QWidget) -> Path | None:
    """Ask for a folder of images."""
    chosen = QFileDialog.getExistingDirectory(parent, "Open folder of images")
    return Path(chosen) if chosen else None


def mesh(parent: QWidget) -> tuple[Path, str] | None:
    """Ask for an object mesh and the unit it is in, which no mesh file says."""
    kinds = {f"{text} ({' '.join('*' + s for s in MESHES)})": unit for unit, text in _UNITS.items()}
    chosen, kind = QFileDialog.getOpenFileName(parent, "Open mesh", "", ";;".join(kinds))
    return (Path(chosen), kinds.get(kind, "auto")) if chosen else None


def calibration(parent: QWidget) -> Path | None:
    """Ask for a calibration."""
    return _open(parent, "Open calibration", "Calibrations (*.npz);;All files (*)")


def alignment(parent: QWidget) -> Path | None:
    """Ask for an alignment."""
    return _open(parent, "Open alignment", f"Alignments (*{ALIGNMENT});;All files (*)")


def alignment_to_save(parent: QWidget) -> Path | None:
    """Ask where an alignment goes."""
    path = _save(parent, "Save alignment", f"Alignments (*{ALIGNMENT})")
    return path if path is None or path.suffix else path.with_suffix(ALIGNMENT)


def session(parent: QWidget) -> Path | None:
    """Ask for a session."""
    return _open(parent, "Open session", f"Sessions (*{SUFFIX});;All files (*)")


def reference(parent: QWidget) -> Path | None:
    """Ask for the image of the untouched sensor."""
    return _open(parent, "Open reference", "Images (*.png *.jpg *.jpeg *.bmp *.tif *.tiff);;All files (*)")


def session_to_save(parent: QWidget) -> Path | None:
    """Ask where a session goes."""
    path = _save(parent, "Save session", f"Sessions (*{SUFFIX})")
    return path if path is None or path.name.endswith(SUFFIX) else path.with_name(path.name + SUFFIX)


def picture_to_save(parent: QWidget) -> Path | None:
    """Ask where a picture of the window goes."""
    path = _save(parent, "Save picture", "Pictures (*.png)")
    return path if path is None or path.suffix else path.with_suffix(".png")


OPENERS: Mapping[str, Callable[[QWidget], Path | None]] = {
    "open_recording": recording,
    "open_folder": folder,
    "open_calibration": calibration,
    "open_alignment": alignment,
    "open_session": session,
}


def _open(parent: QWidget, title: str, kinds: str) -> Path | None:
    chosen, _ = QFileDialog.getOpenFileName(parent, title, "", kinds)
    return Path(chosen) if chosen else None


def _save(parent: QWidget, title: str, kinds: str) -> Path | None:
    chosen, _ = QFileDialog.getSaveFileName(parent, title, "", kinds)
    return Path(chosen) if chosen else None
