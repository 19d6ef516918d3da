"""File dialogs."""

import shlex
from collections.abc import Mapping
from pathlib import Path

from PyQt6.QtWidgets import QFileDialog, QWidget

from app.session.state import SESSION_SUFFIX
from pipeline.core.geometry.meshes import UnitProblem
from pipeline.io.formats import make_dialog_filter

ALIGNMENT_SUFFIX = ".toml"
WEIGHTS_SUFFIX = ".safetensors"
MESH_SUFFIXES = (".stl", ".obj", ".ply", ".urdf")
UNIT_NAMES = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches"}
_UNITS = {"auto": "Meshes, unit from size"} | {
    unit: f"Meshes in {name}" for unit, name in UNIT_NAMES.items()
}

_RECORDINGS = "recordings"  # stands for the file kinds of all formats
# command -> title and kinds of files, none for a folder
OPEN_DIALOGS: Mapping[str, tuple[str, str]] = {
    "open_recording": ("Open recording", _RECORDINGS),
    "set_variant_recording": ("Compare with recording", _RECORDINGS),
    "open_folder": ("Open folder", ""),
    "open_rollouts": ("Open rollouts", ""),
    "open_track": ("Open track", ""),
    "open_calibration": ("Open calibration", "Calibrations (*.npz);;All files (*)"),
    "open_weights": (
        "Open weights",
        "Weights of a network (*.safetensors *.ckpt *.pth *.pt);;All files (*)",
    ),
    "open_reference": (
        "Open reference",
        "Images (*.png *.jpg *.jpeg *.bmp *.tif *.tiff);;All files (*)",
    ),
    "open_alignment": ("Open alignment", f"Alignments (*{ALIGNMENT_SUFFIX});;All files (*)"),
    "open_session": ("Open session", f"Sessions (*{SESSION_SUFFIX});;All files (*)"),
}
_SAVERS = {  # command -> title, kind of file, suffix
    "save_calibration": ("Save calibration", "Calibrations", ".npz"),
    "save_alignment": ("Save alignment", "Alignments", ALIGNMENT_SUFFIX),
    "save_session": ("Save session", "Sessions", SESSION_SUFFIX),
    "save_session_as": ("Save session as", "Sessions", SESSION_SUFFIX),
    "save_screenshot": ("Save screenshot", "Images", ".png"),
    "export_bundle": ("Export repro bundle", "Repro bundles", ".bundle"),
    "export_track": ("Export track", "Tracks", ".track"),
}


def ask_open_path(parent: QWidget, command: str, folder: str = "") -> Path | None:
    """Ask for the file or folder that a command opens, starting in `folder`; None if cancelled."""
    title, kinds = OPEN_DIALOGS[command]
    kinds = make_dialog_filter() if kinds == _RECORDINGS else kinds
    if kinds:
        chosen, _ = QFileDialog.getOpenFileName(parent, title, folder, kinds)
    else:
        chosen = QFileDialog.getExistingDirectory(parent, title, folder)
    return Path(chosen) if chosen else None


def ask_save_path(parent: QWidget, command: str, folder: str = "") -> Path | None:
    """Ask where a command writes to.

    A missing suffix is added, for sessions always. None if cancelled.
    """
    title, kind, suffix = _SAVERS[command]
    keeps_own = suffix != SESSION_SUFFIX
    return _ask_name(parent, title, folder, kind, suffix, keeps_own=keeps_own)


def ask_export_path(parent: QWidget, title: str, suffix: str, folder: str = "") -> Path | None:
    """Ask for a file name that ends in `suffix`; None if cancelled."""
    return _ask_name(parent, title, folder, suffix.removeprefix(".").upper(), suffix)


def _ask_name(
    parent: QWidget, title: str, folder: str, kind: str, suffix: str, *, keeps_own: bool = False
) -> Path | None:
    chosen, _ = QFileDialog.getSaveFileName(parent, title, folder, f"{kind} (*{suffix})")
    if not chosen:
        return None
    path = Path(chosen)
    is_named = chosen.lower().endswith(suffix) or (keeps_own and path.suffix)
    return path if is_named else path.with_name(path.name + suffix)


def quote_path(path: Path) -> str:
    """Quote a path for a command line."""
    return shlex.quote(str(path.absolute()))


def format_unit_problem(error: UnitProblem) -> str:
    """Return the message for a mesh opened in the wrong unit, with the remedy."""
    units = " or ".join(f"'{_UNITS[unit]}'" for unit in error.fits)
    return f"{error.size}; choose 'Open mesh…' and there {units}: '{error.path}'"


def ask_mesh(parent: QWidget, _command: str, folder: str = "") -> tuple[Path, str] | None:
    """Ask for an object mesh and its unit, which mesh files do not state; None if cancelled."""
    kinds = {
        f"{text} ({' '.join('*' + s for s in MESH_SUFFIXES)})": unit
        for unit, text in _UNITS.items()
    }
    chosen, kind = QFileDialog.getOpenFileName(parent, "Open mesh", folder, ";;".join(kinds))
    return (Path(chosen), kinds.get(kind, "auto")) if chosen else None
