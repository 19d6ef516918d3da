"""Map which starting poses lead a registration to which minimum.

Starts are a grid around a pose: rotated about the contact's normal and shifted in its plane. A wide basin means that
the minimum is reached from nearly anywhere. Minima that fit equally well are a symmetry of the object, or of its part
in contact.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.base.arrays import Doubles, Indices, Mask, freeze
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.geometry import rigid
from pipeline.registration.pose_selection import find_unobservable_motions
from pipeline.registration.search import PoseMinimum, PoseSearch

ShiftAxis = Literal["x", "y"]
NO_MINIMUM = -1
_MIN_FITNESS = 0.05  # share of the contact on the object; below it a start counts as failed
_PREPARATION_SHARE = 0.1  # share of the time for preparation, for progress


@dataclass(frozen=True, slots=True, kw_only=True)
class BasinMinimum:
    """One minimum that starts end in."""

    sensor_from_object: Doubles  # (4, 4) mm, best of those that ended here
    rmse_mm: float
    fitness: float
    misfit_mm: float  # misfit over contact and free space
    n_starts: int  # number of starts that ended here
    fits_equally: bool  # whether the touch cannot distinguish it from the mapped pose


@dataclass(frozen=True, slots=True, kw_only=True)
class StartBasins:
    """A grid of starts and the minimum that each ended in; the first minimum is the mapped pose's own."""

    rotations_deg: Doubles  # (cols,) about the contact's normal
    translations_mm: Doubles  # (rows,) in the contact's plane,
    shift_axis: ShiftAxis  # toward this axis of the sensor
    minimum_index: Indices  # (rows, cols) index into `minima`; NO_MINIMUM = the start failed
    rmse_mm: Doubles  # (rows, cols) NaN where the start failed
    poses: Doubles  # (rows, cols, 4, 4)
    minima: tuple[BasinMinimum, ...]

    @property
    def safe_range(self) -> tuple[float, float]:
        """Return (deg, mm): the largest box in which every start ends in the first minimum or an equal one."""
        own = np.isin(self.minimum_index, [k for k, answer in enumerate(self.minima) if answer.fits_equally])
        best, most = (0.0, 0.0), 0
        for turn in np.unique(np.abs(self.rotations_deg)):
            for shift in np.unique(np.abs(self.translations_mm)):
                inside: Mask = own[np.abs(self.translations_mm) <= shift][:, np.abs(self.rotations_deg) <= turn]
                if inside.all() and inside.size > most:
                    best, most = (float(turn), float(shift)), inside.size
        return best

    @property
    def summary(self) -> str:
        """Return the map in one sentence."""
        share = float((self.minimum_index == 0).mean())
        equal = sum(answer.fits_equally for answer in self.minima)
        turn, shift = self.safe_range
        parts = [
            f"{len(self.minima)} minima from {self.minimum_index.size} starts; {share:.0%} end in this pose",
            f"safe within {turn:.0f} deg and {shift:.1f} mm",
        ]
        if equal > 1:
            parts.append(f"{equal} minima fit equally well: the touch cannot distinguish them")
        return "; ".join(parts)


def map_basins(
    search: PoseSearch,
    pose: Doubles,
    turns_deg: Doubles,
    shifts_mm: Doubles,
    along: ShiftAxis,
    progress: Progress = SILENT,
) -> StartBasins:
    """Register every start of a grid around `pose` (4, 4) to convergence; minima after the first are best first."""
    begun = make_start_grid(search, pose, turns_deg, shifts_mm, along)
    flat = begun.reshape(-1, 4, 4)
    progress.step(0.0, "registering the starts roughly")
    rough = search.register_roughly(flat)
    part = SubProgress(progress, _PREPARATION_SHARE, 1.0 - _PREPARATION_SHARE)
    minima: list[PoseMinimum | None] = []
    for k, start in enumerate(rough):
        part.step(k / len(rough), f"start {k + 1} of {len(rough)}")
        found = search.polish(start)
        minima.append(found if found is not None and found.fit.fitness >= _MIN_FITNESS else None)
    own = search.polish(pose)
    first = pose if own is None else own.fit.sensor_from_object
    which, answers = _group_minima(search, first, minima)
    shape = begun.shape[:2]
    rmse = np.array([np.nan if m is None else m.fit.rmse_mm for m in minima])
    ends = np.array([start if m is None else m.fit.sensor_from_object for m, start in zip(minima, flat, strict=True)])
    return StartBasins(
        rotations_deg=freeze(np.asarray(turns_deg, np.float64)),
        translations_mm=freeze(np.asarray(shifts_mm, np.float64)),
        shift_axis=along, minimum_index=freeze(which.reshape(shape)), rmse_mm=freeze(rmse.reshape(shape)),
        poses=freeze(ends.reshape(*shape, 4, 4)), minima=answers,
    )  # fmt: skip


def make_start_grid(
    search: PoseSearch, pose: Doubles, turns_deg: Doubles, shifts_mm: Doubles, along: ShiftAxis
) -> Doubles:
    """Return start poses (rows, cols, 4, 4): `pose` rotated about the contact's normal and shifted in its plane."""
    normal = search.scene.normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    axis = np.eye(3)[0 if along == "x" else 1]
    axis = axis - (axis @ normal) * normal
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    middle = search.middle_mm
    here, back = rigid.translation(*middle), rigid.translation(*-middle)
    turned = [here @ rigid.rotation(normal * np.deg2rad(deg)) @ back @ pose for deg in turns_deg]
    return np.array([[rigid.translation(*(mm * axis)) @ one for one in turned] for mm in shifts_mm])


def _group_minima(
    search: PoseSearch, first: Doubles, minima: list[PoseMinimum | None]
) -> tuple[Indices, tuple[BasinMinimum, ...]]:
    """Assign each start to a minimum; the first minimum is the mapped pose's own, the others are best first."""
    free = find_unobservable_motions(search, first)
    known = [minimum for minimum in minima if minimum is not None]
    places: list[tuple[Doubles, list[PoseMinimum]]] = [(first, [])]
    at: dict[int, int] = {}
    for minimum in sorted(known, key=lambda m: m.misfit_mm):
        pose = minimum.fit.sensor_from_object
        index = next(
            (i for i, (there, _) in enumerate(places) if not search.poses_differ_beyond(there, pose, free)), len(places)
        )
        if index == len(places):
            places.append((pose, []))
        places[index][1].append(minimum)
        at[id(minimum)] = index
    kept = [i for i, (_, ended) in enumerate(places) if ended or i == 0]
    fine = search.make_fine_judge()
    answers = tuple(
        _make_minimum(places[i], equal=i == 0 or not fine.distinguishes(first, places[i][0]), own=search) for i in kept
    )
    which = np.array([NO_MINIMUM if m is None else at[id(m)] for m in minima], np.int32)
    return which, answers


def _make_minimum(place: tuple[Doubles, list[PoseMinimum]], *, equal: bool, own: PoseSearch) -> BasinMinimum:
    pose, ended = place
    best = ended[0] if ended else own.polish(pose)
    return BasinMinimum(
        sensor_from_object=freeze(pose if best is None else best.fit.sensor_from_object),
        rmse_mm=float("nan") if best is None else best.fit.rmse_mm, fitness=0.0 if best is None else best.fit.fitness,
        misfit_mm=float("nan") if best is None else best.misfit_mm, n_starts=len(ended), fits_equally=equal,
    )  # fmt: skip
