"""The machine, versions and threads that a measurement is made with."""

import importlib.metadata
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

N_THREADS = 2
THREAD_SETTINGS: Mapping[str, str] = {
    "OMP_NUM_THREADS": str(N_THREADS),
    "OPENBLAS_NUM_THREADS": "1",  # as in every process of ours
    "MKL_NUM_THREADS": str(N_THREADS),
    "NUMBA_NUM_THREADS": str(N_THREADS),
    "TBB_NUM_THREADS": str(N_THREADS),
    "OMP_WAIT_POLICY": "PASSIVE",  # idle threads of other libraries must not occupy our cores
}
_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "open3d-cpu",
    "small_gicp",
    "torch",
    "taxim",
)


def describe_processor() -> str:
    """Return the processor's model name."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass  # only Linux has this file
    return platform.processor() or platform.machine()


def describe_machine(environment: Mapping[str, str] = os.environ) -> dict[str, Any]:
    """Processor, cores, load, Python, thread settings and package versions (None = not
    installed), ready for JSON.
    """
    return {
        "cpu": describe_processor(),
        "cores": os.cpu_count() or 0,
        "system": platform.platform(),
        "python": platform.python_version(),
        "threads": {name: environment.get(name) for name in THREAD_SETTINGS},
        "load": [round(load, 2) for load in os.getloadavg()] if hasattr(os, "getloadavg") else [],
        "packages": {name: _version(name) for name in _PACKAGES},
    }


def format_machine(about: Mapping[str, Any]) -> str:
    """Return the description in one line."""
    versions = ", ".join(
        f"{name} {version}" for name, version in about["packages"].items() if version
    )
    threads = about["threads"]["OMP_NUM_THREADS"]
    load = f", load {about['load'][0]:g}" if about["load"] else ""
    return (
        f"{about['cpu']}, {about['cores']} cores{load}; {threads or 'default'} threads; "
        f"Python {about['python']}, {versions}"
    )


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
