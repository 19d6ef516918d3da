"""The likeliest object of a folder of meshes: its registered mesh, pressed into the source,
explains the touch best.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pipeline.core.errors import MeshProblem, SettingProblem, StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.geometry.meshes import load_mesh
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap
from pipeline.physics.simulation.datasets import MESH_SUFFIXES
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.stages.touch.membrane_fit import measure_residuals
from pipeline.translation.frame_selection import find_contact_frame
from pipeline.translation.translate import Translation

_CLEAR_RATIO = 1.3  # of the next residual to the least, below which the object is not certain


@frozen
class IdentifiedObject:
    """The likeliest mesh of a folder, and how clearly it is."""

    path: Path
    note: str  # its residual and the next one's; a warning where they are close


def identify_object(
    depth: DepthMap,
    source: SensorSpec,
    folder: Path,
    mesh_unit: str = "auto",
    progress: Progress = SILENT,
) -> IdentifiedObject:
    """Register every mesh of `folder` on the source's depth and compare what is left of the
    membrane.

    Raises SettingProblem for a folder without meshes, or of which none fits the touch.
    """
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in MESH_SUFFIXES)
    if not files:
        raise SettingProblem(
            f"--meshes needs a folder of meshes ({', '.join(MESH_SUFFIXES)}), got '{folder}'"
        )
    residuals_mm: dict[Path, float] = {}
    problems: list[str] = []
    for k, path in enumerate(files):
        progress.step(k / len(files), f"comparing the object with {path.stem}")
        try:
            mesh = load_mesh(path, unit=mesh_unit)
            pose = estimate_pose(depth, mesh, PoseParams())
        except MeshProblem as problem:
            problems.append(str(problem))
            continue
        if pose.sensor_from_object is not None:
            poses = (pose.sensor_from_object, *pose.alternatives)
            residuals = measure_residuals(depth, mesh, source, poses)
            residuals_mm[path] = min(residual.rms_mm for residual in residuals)
    if not residuals_mm:
        why = f": {problems[0]}" if problems else "; choose another frame or --meshes folder"
        raise SettingProblem(f"none of the {len(files)} meshes fits the touch{why}")
    best, *others = sorted(residuals_mm, key=lambda path: residuals_mm[path])
    left_out = f"; {len(problems)} were left out: {problems[0]}" if problems else ""
    text = (
        f"the likeliest of {len(files)} objects is {best.stem}, "
        f"{1e3 * residuals_mm[best]:.3g} um off"
    )
    if not others:
        return IdentifiedObject(path=best, note=text + left_out)
    text += f"; the next is {others[0].stem}, {1e3 * residuals_mm[others[0]]:.3g} um off{left_out}"
    if residuals_mm[others[0]] < _CLEAR_RATIO * residuals_mm[best]:
        text = StageWarning(f"{text}: not certain; give the object with --mesh")
    return IdentifiedObject(path=best, note=text)


def take_likeliest_mesh(
    translation: Translation, folder: Path, frame: int | None = None, progress: Progress = SILENT
) -> Translation:
    """The translation of the likeliest object of a folder by one frame, with a note of its margin.

    Frame None: the one that differs most from its reference. Raises as `identify_object` does.
    """
    index = find_contact_frame(translation.stream) if frame is None else frame
    depth = translation.evaluate(index, ["depth"])["depth"].output
    unit = translation.request.mesh_unit
    found = identify_object(depth, translation.source, folder, unit, progress)
    return replace(
        translation,
        mesh=load_mesh(found.path, unit=unit),
        symmetry=None,
        notes=(*translation.notes, found.note),
        request=replace(translation.request, mesh=found.path),
    )
