"""`tactoscope prepare`: every kernel compiled once, so that the first touch of a new process is quick."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from rich.console import Console

from pipeline.base import compiling
from pipeline.cli.terminal import print_line

if TYPE_CHECKING:
    from pipeline.base.arrays import Image

SAMPLE_RECORDING = Path(__file__).parents[2] / "sample_data" / "recordings" / "first_touch.h5"
_FRAME = 5  # a firm touch
_WAYS = (("gelslim", "soft_bubble"), ("soft_bubble", "digit"), ("digit", "gelslim"))
_PRESSED = ("soft_bubble", "digit")
_ODDLY_LIT = ("gelsight_mini", "digit")
_TOOL = "notched_elbow"


def compile_kernels() -> int:
    """Put the chain and the simulator to work until no kernel is left to compile; says nothing was to do if so."""
    waiting = len(compiling.list_uncompiled())
    if waiting:
        before_s = time.process_time()
        with Console(stderr=True).status("compiling, once") as status, compiling.report_compiling(status.update):
            for task in _tasks():
                task()
        print_line(f"{waiting} kernels compiled in {time.process_time() - before_s:.0f} s of computing")
    left = compiling.list_uncompiled()
    for name in left:
        print_line(f"not needed by the sample, compiled when it is: {name}")
    print_line(
        f"{len(compiling.list_kernels()) - len(left)} kernels are ready in {compiling.kernel_folder(Path(__file__)).parent}"
    )
    return 0


def _tasks() -> Iterator[Callable[[], object]]:
    """Work that calls every kernel, what the sample needs first."""
    from pipeline.translation.catalogue import BUILT_IN, default_params, with_setting

    params = default_params(BUILT_IN.methods("t2d2"))
    for source, target in _WAYS:
        yield partial(_translated, source, target, params)
    # Points: the paper's, and those too sparse for a surface.
    yield partial(_translated, *_WAYS[0], params, (("target_depth", "paper"),))
    yield partial(_translated, *_WAYS[0], with_setting(params, "cloud.stride=16"))
    yield from (_surveyed, _pressed, _oddly_lit)


def _translated(source: str, target: str, params: dict[str, object], methods: tuple[tuple[str, str], ...] = ()) -> None:
    from pipeline.translation.translate import Request, open_translation

    with closing(
        open_translation(Request(recording=SAMPLE_RECORDING, source=source, target=target, methods=methods))
    ) as it:
        it.build_graph().evaluate(it.stages, it.read_inputs(_FRAME), params)


def _surveyed() -> None:
    """A mesh's distances, a rest surface read off a mesh, and distances from rest surfaces of both kinds."""
    from pipeline.geometry import distance_grid, mesh_membrane
    from pipeline.geometry.meshes import Mesh
    from pipeline.sensors.spec import load_sensor
    from pipeline.simulation import shapes

    corners = np.array([[x, y, 20.0] for y in (-5.0, 5.0) for x in (-5.0, 5.0)])
    sheet = Mesh(vertices_mm=corners, triangles=np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    mesh_membrane.from_mesh(sheet)
    for mesh in (shapes.make_shape(_TOOL).mesh, sheet):
        distance_grid.build_grid(mesh)
    for name in _PRESSED:
        load_sensor(name).membrane.signed_distance_mm(np.full((100_000, 3), 10.0, np.float32))


def _pressed() -> None:
    """The same press, felt by a bubble and by a gel that prints no markers."""
    from pipeline.sensors.spec import load_sensor
    from pipeline.simulation import shapes
    from pipeline.simulation.poses import make_paper_grid
    from pipeline.simulation.press import simulate_press

    thing = shapes.make_shape(_TOOL).mesh
    pose = make_paper_grid(thing, n=1, seed=0)[0]
    for name in _PRESSED:
        simulate_press(thing, pose, load_sensor(name), seed=0)


def _oddly_lit() -> None:
    """Touches in colours that no unit's lamps explain, without shadows and with: lights of their own are tried."""
    from pipeline.physics import optics
    from pipeline.sensors.spec import load_sensor
    from pipeline.simulation import shapes
    from pipeline.simulation.poses import make_paper_grid
    from pipeline.simulation.press import simulate_press
    from pipeline.stages.depth.photometric import DepthParams, estimate_depth
    from pipeline.values.frames import TactileFrame

    thing = shapes.make_shape(_TOOL).mesh
    for gel in map(load_sensor, _ODDLY_LIT):
        image = cast("Image", simulate_press(thing, make_paper_grid(thing, n=1, seed=0)[0], gel, seed=0).image)
        swapped = np.ascontiguousarray(image[..., ::-1])
        untouched = np.ascontiguousarray(optics.render_reference(gel)[..., ::-1])
        estimate_depth(TactileFrame(sensor=gel.name, image=swapped, reference=untouched), gel, None, DepthParams())
