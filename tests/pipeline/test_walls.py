"""The headless wall and the price of start-up, seen from a fresh interpreter."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = (
    "PyQt6",
    "qtpy",
    "pyvista",
    "pyvistaqt",
    "pyqtgraph",
    "vtk",
    "vtkmodules",
    "torch",
    "open3d",
    "numba",
    "matplotlib",
)
EVERY_MODULE = """
import importlib, json, pkgutil, sys
import pipeline
networks = {"pipeline.stages.networks." + name for name in ("weights", "network_factory", "published_weights", "onnx_predictor")}
for module in pkgutil.walk_packages(pipeline.__path__, "pipeline."):
    if module.name.startswith("pipeline.stages.networks.") and module.name not in networks:
        continue  # a network is a class of torch's; its module is imported when it is built
    if not module.name.endswith(("_kernels", "_loss", "__main__")):  # a loss is a sum of torch's; training imports it
        importlib.import_module(module.name)
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""
HELP = """
import json, sys
from app.command import main
sys.argv = ["tactoscope", "--help"]
try:
    main()
except SystemExit as stop:
    assert stop.code == 0, stop.code
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""

FIRST_DEPTH = """
import json, sys
import numpy as np
from pipeline.core.progress import SILENT
from pipeline.physics.optics import render_reference
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.core.values.frames import TactileFrame
digit = load_sensor("digit")
reference = render_reference(digit)
image = reference.copy()
image[100:160, 80:160] = 255 - image[100:160, 80:160]
estimate_depth(TactileFrame(sensor="digit", image=image.astype(np.uint8), reference=reference), digit, None, DepthParams(), SILENT)
print(json.dumps(sorted(sys.modules)))
"""


def loaded_by(code: str) -> set[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_every_module_of_the_pipeline_loads_no_gui_and_nothing_heavy():
    assert loaded_by(EVERY_MODULE).isdisjoint(HEAVY)


def test_help_loads_not_even_numpy():
    assert loaded_by(HELP).isdisjoint((*HEAVY, "numpy", "scipy", "cv2", "h5py"))


def test_a_first_depth_loads_nothing_that_only_compiling_or_another_picture_needs():
    """Half a second, and tens of megabytes that stay, for each new process."""
    loaded_by(FIRST_DEPTH)  # compiles what is not compiled yet
    loaded = loaded_by(FIRST_DEPTH)
    assert {"numba.core.dispatcher", "scipy.fft"} <= loaded
    assert loaded.isdisjoint(
        {
            "numba.np.arraymath",
            "numba.typed.typeddict",
            "scipy.linalg",
            "numpy.f2py.crackfortran",
            "unittest",
        }
    )


@pytest.mark.parametrize("name", ["torch", "open3d", "numba", "matplotlib"])
def test_every_heavy_library_is_really_installed(name):
    """Otherwise the two tests above would pass for the wrong reason."""
    import importlib.util

    assert importlib.util.find_spec(name) is not None
