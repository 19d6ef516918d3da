"""`tactoscope prepare`: compile all kernels once, so that the first touch of a new process is
fast.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from rich.console import Console

from pipeline.cli.terminal import print_line
from pipeline.core import compiling

if TYPE_CHECKING:
    from pipeline.core.arrays import Image

SAMPLE_RECORDING = Path(__file__).parents[2] / "sample_data" / "recordings" / "first_touch.h5"
_FRAME = 5  # a firm touch
_DIRECTIONS = (("gelslim", "soft_bubble"), ("soft_bubble", "digit"), ("digit", "gelslim"))
_PRESS_SENSORS = ("soft_bubble", "digit")
_ADAPTIVE_SENSORS = ("gelsight_mini", "digit")
_TOOL = "notched_elbow"
_MARKER = "prepared"  # file in the cache folder: nothing is left to compile


def prepare() -> int:
    """Run the chain and the simulator once, so that all their kernels are compiled and cached.

    0.
    """
    folder = compiling.kernel_folder()
    marker = folder / _MARKER
    if not marker.exists():
        before_s = time.process_time()
        with (
            Console(stderr=True).status("compiling kernels") as status,
            compiling.report_compiling(status.update),
        ):
            for task in _list_tasks():
                task()
        n = compiling.count_compiled()
        print_line(
            f"{n} kernels compiled in {time.process_time() - before_s:.0f} s of processor time"
        )
        with contextlib.suppress(OSError):
            marker.touch()
    print_line(f"all kernels are compiled, cached in {folder}")
    return 0


def _list_tasks() -> Iterator[Callable[[], object]]:
    """Yield tasks that together call every kernel; those that the sample needs come first."""
    for source, target in _DIRECTIONS:
        yield partial(_translate_sample, source, target)
    # Points: the paper's, and those too sparse for a surface.
    yield partial(_translate_sample, *_DIRECTIONS[0], (("target_depth", "paper"),))
    yield partial(_translate_sample, *_DIRECTIONS[0], settings=("cloud.stride=16",))
    yield from (_build_geometry, _simulate_presses, _estimate_adaptive_depth)


def _translate_sample(
    source: str,
    target: str,
    methods: tuple[tuple[str, str], ...] = (),
    settings: tuple[str, ...] = (),
) -> None:
    from pipeline.physics.simulation.datasets import SimulationPlan, make_recording
    from pipeline.translation.translate import Request, open_translation

    recording = None
    if not SAMPLE_RECORDING.exists():  # an installed package brings no samples
        plan = SimulationPlan(sensors=(source,), object_source=_TOOL, n_poses=1, seed=0)
        recording = make_recording(plan)
    request = Request(recording=SAMPLE_RECORDING, source=source, target=target, methods=methods)
    with open_translation(request, recording=recording, settings=settings) as opened:
        opened.evaluate(_FRAME if recording is None else 0)


def _build_geometry() -> None:
    """Build the distance grids of a closed and of an open mesh."""
    from pipeline.core.geometry import distance_grid
    from pipeline.core.geometry.meshes import Mesh
    from pipeline.physics.simulation import shapes

    corners = np.array([[x, y, 20.0] for y in (-5.0, 5.0) for x in (-5.0, 5.0)])
    sheet = Mesh(vertices_mm=corners, triangles=np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    for mesh in (shapes.make_shape(_TOOL).mesh, sheet):
        distance_grid.build_grid(mesh)


def _simulate_presses() -> None:
    """Simulate one press with a bubble and with a gel without markers."""
    from pipeline.physics.simulation import shapes
    from pipeline.physics.simulation.poses import make_paper_grid
    from pipeline.physics.simulation.press import simulate_press
    from pipeline.sensors.spec import load_sensor

    mesh = shapes.make_shape(_TOOL).mesh
    pose = make_paper_grid(mesh, n=1, seed=0)[0]
    for name in _PRESS_SENSORS:
        simulate_press(mesh, pose, load_sensor(name), seed=0)


def _estimate_adaptive_depth() -> None:
    """Estimate depth with swapped colours, so that adaptive illumination is tried with and
    without shadows.
    """
    from pipeline.core.values.frames import TactileFrame
    from pipeline.physics import optics
    from pipeline.physics.simulation import shapes
    from pipeline.physics.simulation.poses import make_paper_grid
    from pipeline.physics.simulation.press import simulate_press
    from pipeline.sensors.spec import load_sensor
    from pipeline.stages.depth.photometric import DepthParams, estimate_depth

    mesh = shapes.make_shape(_TOOL).mesh
    for gel in map(load_sensor, _ADAPTIVE_SENSORS):
        image = cast(
            "Image", simulate_press(mesh, make_paper_grid(mesh, n=1, seed=0)[0], gel, seed=0).image
        )
        swapped = np.ascontiguousarray(image[..., ::-1])
        reference = np.ascontiguousarray(optics.render_reference(gel)[..., ::-1])
        estimate_depth(
            TactileFrame(sensor=gel.name, image=swapped, reference=reference),
            gel,
            None,
            DepthParams(),
        )
