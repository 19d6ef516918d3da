"""`tactoscope simulate`: simulated recordings, one per object.

An interrupted run can be continued.
"""

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from pipeline.cli.terminal import open_progress_bar, print_line
from pipeline.cli.translation_options import split_list
from pipeline.core.errors import FileProblem
from pipeline.core.files import check_folder_for
from pipeline.core.params import MeshUnit
from pipeline.core.progress import SubProgress
from pipeline.lab import recorder
from pipeline.physics.simulation import datasets
from pipeline.physics.simulation.datasets import SimulationPlan


def simulate(
    *,
    sensors: str,
    tools: str,
    out: Path,
    poses: int = 60,
    seed: int = 0,
    sequence: Literal["grid", "press", "slide", "twist", "release", "all"] = "grid",
    vary: float = 0.0,
    noise: bool = True,
    bubble_deeper_mm: float = 9.0,
    drag_mm: float = 0.0,
    jobs: int = 2,
    mesh_unit: MeshUnit = "auto",
    mesh_face: Literal["-x", "+x", "-y", "+y", "-z", "+z"] = "-z",
) -> int:
    """Simulate and write the frames that are missing.

    Ctrl-C and SIGTERM raise KeyboardInterrupt between two frames.

    Args:
        sensors: Sensors that record the same presses, comma-separated, such as
            `gelslim,soft_bubble`.
        tools: Objects, such as `NAME,NAME`; the groups `training`, `unseen`, `task` or `all`; or a
            mesh file.
        out: One `.h5` file for one object, otherwise a folder with one `.h5` per object.
        poses: Grasps per object, or frames of the sequence.
        seed: Seed of poses, noise and sensor instances.
        sequence: `grid` is single grasps over 10 mm x 10 mm and up to 45 degrees; the others are
            moving touches, and `all` is press, slide, twist and release in a row.
        vary: Variation between sensor instances, 1 = as between real ones; every ten frames use a
            new instance.
        noise: Whether frames have camera noise.
        bubble_deeper_mm: Distance by which a bubble is nearer to the object than its description
            says.
        drag_mm: Distance that each object has slid along the gels since contact, at a friction of
            0.8: it moves the markers.
        jobs: Number of processes.
        mesh_unit: Unit of a mesh file.
        mesh_face: Side of a mesh file that touches, such as `--mesh-face=-x`.
    """
    template = SimulationPlan(
        sensors=split_list(sensors),
        object_source="",
        n_poses=poses,
        seed=seed,
        sequence=sequence,
        vary=vary,
        noise=noise,
        bubble_deeper_mm=bubble_deeper_mm,
        drag_mm=drag_mm,
        mesh_unit=mesh_unit,
        mesh_face=mesh_face,
    )
    plans = datasets.make_plans(split_list(tools), template)
    files = [recorder.resolve_recording_path(plan, out, len(plans)) for plan in plans]
    n_finished = sum(
        recorder.count_finished_moments(plan, path) for plan, path in zip(plans, files, strict=True)
    )
    total = sum(plan.n_poses for plan in plans)
    if n_finished == total:
        raise FileProblem(
            "all of this is simulated already and is kept; choose another --out or --seed", out
        )
    for path in files:
        check_folder_for(path)
    n_unsolved = 0
    with ExitStack() as stack:
        # Checks `jobs`; starts no process before there is work.
        pool = stack.enter_context(recorder.make_worker_pool(jobs))
        bar = stack.enter_context(open_progress_bar(total))
        use_pool = jobs > 1 and total - n_finished >= recorder.MIN_MOMENTS_FOR_POOL
        for k, (plan, path) in enumerate(zip(plans, files, strict=True)):
            part = SubProgress(bar, k / len(plans), 1.0 / len(plans))
            result = recorder.record_plan(
                plan, path, pool=pool if use_pool else None, progress=part
            )
            n_unsolved += result.n_unsolved
    print_line(
        f"{total} moments of {len(plans)} objects for {', '.join(template.sensors)} in "
        f"{os.fspath(out)}"
    )
    if n_unsolved:
        print_line(f"{n_unsolved} frames did not converge; they are kept without ground truth")
    return 0
