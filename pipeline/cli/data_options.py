"""The commands that make data: simulated touches, and look-ups fitted to presses of a ball."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pipeline.base.units import MeshUnit
from pipeline.cli.translation_options import split_list


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
    scheduler: str = "",
    mesh_unit: MeshUnit = "auto",
    mesh_face: Literal["-x", "+x", "-y", "+y", "-z", "+z"] = "-z",
) -> int:
    """Simulate touches that several sensors feel at once, with all that is true of them, as recordings.

    Ctrl-C keeps what is finished; the same command goes on from there. The same seed gives the same readings.

    Parameters
    ----------
    sensors
        Sensors that feel the same presses, such as `gelslim,soft_bubble`.
    tools
        Objects, such as `NAME,NAME`; the groups `training`, `unseen`, `task` or `all`; or a mesh file.
    out
        One `.h5` file for one object, otherwise a folder that gets one `.h5` for each.
    poses
        Single grasps of each object, or frames of the sequence.
    seed
        Seed of poses, noise and specimens.
    sequence
        `grid` is single grasps over 10 mm x 10 mm and up to 45 degrees; the others are moving touches, and `all` is
        press, slide, twist and release in a row.
    vary
        How far specimens of a sensor differ, 1 = as much as real ones; a new specimen is taken every ten moments.
    noise
        Whether readings have their camera's noise.
    bubble_deeper_mm
        How much farther a bubble comes to meet the object than its description says.
    drag_mm
        How far each object has gone along the gels since it touched them, at a friction of 0.8: markers move with it.
    jobs
        Processes that work at once.
    scheduler
        Address of a Dask scheduler whose workers press in their place, such as `tcp://host:8786`.
    mesh_unit
        Unit of a mesh file.
    mesh_face
        Side of a mesh file that touches, such as `--mesh-face=-x`.
    """
    from pipeline.cli.simulate import simulate_recordings
    from pipeline.simulation.datasets import SimulationPlan

    like = SimulationPlan(
        sensors=split_list(sensors), object_source="", n_poses=poses, seed=seed, sequence=sequence, vary=vary, noise=noise,
        bubble_deeper_mm=bubble_deeper_mm, drag_mm=drag_mm,
        mesh_unit=mesh_unit, mesh_face=mesh_face,
    )  # fmt: skip
    return simulate_recordings(split_list(tools), like, out, jobs, scheduler)


def balls(
    presses: Path,
    *,
    sensor: str,
    diameter_mm: float,
    reference: Path,
    out: Path,
    pixel_mm: float | None = None,
    pattern: str = "*",
    seed: int = 0,
) -> int:
    """Fit a sensor's colour-to-slope look-up to presses of a ball, and report how well it fits.

    Parameters
    ----------
    presses
        Folder of images, one press each, anywhere on the gel.
    sensor
        The sensor that made them.
    diameter_mm
        Diameter of the ball.
    reference
        Image of the untouched sensor.
    out
        Look-up file to write (.npz).
    pixel_mm
        Width of a pixel on the gel; the sensor description's if not given.
    pattern
        Which file names of the folder to use, such as `ball_6.310mm_*`.
    seed
        Seed of the fit; the same seed gives the same look-up.
    """
    from pipeline.cli.calibrate import BallCalibrationRequest, run_ball_calibration

    asked = BallCalibrationRequest(
        presses=presses, sensor=sensor, diameter_mm=diameter_mm, reference=reference, out=out, pixel_mm=pixel_mm,
        pattern=pattern, seed=seed,
    )  # fmt: skip
    return run_ball_calibration(asked)
