"""`tactoscope doctor`: checks of Python, packages, system libraries, display, sensors and sample
recordings.
"""

import importlib.metadata
import os
import platform
import shutil
import sys
from collections.abc import Iterator
from contextlib import closing
from ctypes.util import find_library
from itertools import chain
from pathlib import Path

from pipeline.cli.terminal import print_line
from pipeline.core.arrays import describe_size
from pipeline.core.errors import TouchError
from pipeline.core.user_folders import has_home
from pipeline.io import open_recording
from pipeline.sensors.spec import list_sensor_names, load_sensor

_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "open3d-cpu",
    "torch",
    "h5py",
    "PyQt6",
    "pyvista",
    "vtk",
)
_LIBRARIES = {
    "GL": "libgl1",
    "EGL": "libegl1",
    "xcb-cursor": "libxcb-cursor0",
    "xcb-icccm": "libxcb-icccm4",
    "usb-1.0": "libusb-1.0-0",
}
_ROOT = Path(__file__).parents[2]


def doctor() -> int:
    """Print one line per check; returns 1 if something is missing."""
    bad = 0
    checks = (_check_machine, _check_packages, _check_libraries, _check_display, _check_project)
    for good, line in chain.from_iterable(check() for check in checks):
        bad += not good
        print_line(f"{'ok     ' if good else 'MISSING'}  {line}")
    print_line(
        "everything is installed"
        if not bad
        else f"{bad} things are missing; each line says how to fix it"
    )
    return 1 if bad else 0


def _check_machine() -> Iterator[tuple[bool, str]]:
    good = sys.version_info >= (3, 11)
    yield (
        good,
        f"Python {platform.python_version()} on {platform.platform()}"
        + ("" if good else "; 3.11 or newer is needed"),
    )
    yield True, f"{os.cpu_count()} cores"
    home = "a home folder for compiled kernels, logs and recovery"
    yield (
        has_home(),
        home if has_home() else f"{home}; set HOME or XDG_CACHE_HOME and XDG_STATE_HOME",
    )


def _check_packages() -> Iterator[tuple[bool, str]]:
    for name in _PACKAGES:
        try:
            yield True, f"{name} {importlib.metadata.version(name)}"
        except importlib.metadata.PackageNotFoundError:
            yield False, f"{name}; run 'make setup'"


def _check_libraries() -> Iterator[tuple[bool, str]]:
    if not sys.platform.startswith("linux"):
        return
    for library, package in _LIBRARIES.items():
        found = find_library(library)
        yield (
            found is not None,
            f"lib{library}" + ("" if found else f"; run 'apt-get install {package}'"),
        )


def _check_display() -> Iterator[tuple[bool, str]]:
    if (
        os.environ.get("DISPLAY")
        or os.environ.get("WAYLAND_DISPLAY")
        or not sys.platform.startswith("linux")
    ):
        yield True, "a display"
        return
    virtual = shutil.which("xvfb-run")
    yield (
        virtual is not None,
        "no display; xvfb-run provides a virtual one"
        if virtual
        else "a display; run 'apt-get install xvfb xauth'",
    )


def _check_project() -> Iterator[tuple[bool, str]]:
    for name in list_sensor_names():
        try:
            spec = load_sensor(name)
            yield (
                True,
                f"sensor {name}: {describe_size(spec.camera.shape)}, "
                f"{len(spec.assumed_keys)} assumed values",
            )
        except TouchError as error:
            yield False, str(error)
    samples = sorted((_ROOT / "sample_data" / "recordings").glob("*.h5"))
    if not samples and (_ROOT / "pyproject.toml").is_file():
        yield False, "the sample recordings; clone the project again"
    elif not samples:
        yield (
            True,
            "no sample recordings and no benchmarks: they are in the source tree, not in the "
            "installed package",
        )
    for path in samples:
        try:
            with closing(open_recording(path)) as recording:
                yield True, f"sample {recording!r}"
        except TouchError as error:
            yield False, str(error)
