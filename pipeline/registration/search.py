"""The places where an object explains a touch: many first guesses compared, the best registered, the distinct kept.

Guesses are ranked by what was felt and by what was not; each step is more exact, and asks fewer of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry import rigid
from pipeline.registration.gauss_newton import Fit, How, NotDetermined, Points, fitted, registered
from pipeline.registration.observability import Observability, effective_count, observability
from pipeline.registration.outline import placed
from pipeline.registration.prepared import Prepared
from pipeline.registration.ranking import CORRELATION_MM, Judge, apart, judge
from pipeline.registration.scene import Scene, in_reach
from pipeline.registration.starts import Start

_COARSE_FELT, _COARSE_MODEL = 50, (500, 4000)  # points that rank the first guesses: at least, at most
_COARSE_MM2 = 1.0  # of the object's surface for each of them
_MIDDLE_FELT, _MIDDLE_MODEL = 150, 1500  # points that rank where these lead
_FINE_FELT, _FINE_MODEL = 750, 15_000  # points that rank what came out of them
_OUTLINE_FELT, _OUTLINE_MODEL = 200, 1000  # points that place it where its surface is silent,
_POLISH_POINTS = 500  # that it is registered with, all of them once more
_DENSE_FELT, _DENSE_MODEL = 400, 4000  # and once more the best
_PER_GROUP, _N_REGISTERED, _N_POLISHED, _N_DENSE = 2, 96, 6, 2
_QUICK_POINTS, _QUICK_ITERATIONS, _QUICK_SETTLED_MM = 100, 10, 0.02
_POLISHED_SHARE = 4.0  # the last registration searches this many times nearer
_OUTLINE_REACH_MM = 4.0  # object this far beyond the contact may stick out beside it
_SAME_SURFACE = 0.5  # cosine of felt and modelled normal from which on both show one surface
_FEWEST = 20  # points that observability rests on
BIAS_MM = 0.005  # of all depths together: calibration, compliance, the mesh
SAME_MM, SAME_DEG = 1.0, 5.0  # poses this close are one


@dataclass(frozen=True, slots=True, kw_only=True)
class Minimum:
    """A place where a registration ended."""

    fit: Fit
    misfit_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """A touch and an object, ready to be compared."""

    scene: Scene
    points: Points
    object: Prepared
    max_distance_mm: float
    n_iterations: int
    keep_steps: bool

    @property
    def middle_mm(self) -> Doubles:
        """Of the contact, which errors and motions are told at."""
        return self.points.about_mm

    def promising(self, tried: Sequence[Start]) -> list[Doubles]:
        """Where the best places of each orientation lead, best first, the distinct ones."""
        n_model = int(np.clip(self.object.model.area_mm2 / _COARSE_MM2, *_COARSE_MODEL))
        by = judge(self.scene, self.object.grid, self.object.model, _COARSE_FELT, n_model, self.max_distance_mm)
        poses = np.array([s.sensor_from_object for s in tried])
        asked: dict[tuple[str, int], int] = {}
        chosen: list[int] = []
        for k in np.argsort(by.misfit_mm(poses), kind="stable"):
            asked[tried[k].group] = asked.get(tried[k].group, 0) + 1
            if asked[tried[k].group] <= _PER_GROUP:
                chosen.append(int(k))
        chosen = chosen[:_N_REGISTERED]
        quick = How(max_distance_mm=self.max_distance_mm, n_iterations=_QUICK_ITERATIONS, settled_mm=_QUICK_SETTLED_MM)
        ended = registered(self.points.thinned(_QUICK_POINTS), self.object.grid, poses[chosen], quick)
        return self._distinct(ended)

    def _distinct(self, poses: Doubles) -> list[Doubles]:
        by = judge(self.scene, self.object.grid, self.object.model, _MIDDLE_FELT, _MIDDLE_MODEL, self.max_distance_mm)
        misfits_mm = by.misfit_mm(poses)
        kept: list[Doubles] = []
        for k in np.argsort(misfits_mm, kind="stable"):
            if all(apart(poses[k], other, self.middle_mm, SAME_MM, SAME_DEG) for other in kept):
                kept.append(poses[k])
            if len(kept) == _N_POLISHED:
                break
        return kept

    def polished(self, pose: Doubles, *, dense: bool = False) -> Minimum | None:
        """Set by the outline where the surface is silent, then registered on all points; None where that fails."""
        weak = self.determined(pose).weak_motions
        if len(weak):
            pose = placed(pose, weak, self.middle_mm, self.outline(pose, dense=dense))
        how = How(
            max_distance_mm=self.max_distance_mm / _POLISHED_SHARE, n_iterations=self.n_iterations,
            keep_steps=self.keep_steps,
        )  # fmt: skip
        fit = fitted(self.points if dense else self.points.thinned(_POLISH_POINTS), self.object.grid, pose, how)
        if isinstance(fit, NotDetermined):
            return None
        return Minimum(fit=fit, misfit_mm=float(self.fine().misfit_mm([fit.sensor_from_object])[0]))

    def fine(self) -> Judge:
        """A judge on the whole object."""
        return judge(self.scene, self.object.grid, self.object.model, _FINE_FELT, _FINE_MODEL, self.max_distance_mm)

    def best(self, starts: Sequence[Doubles], progress: Progress = SILENT) -> list[Minimum]:
        """The minima that the starts lead to, best first; the best is set by the outline once more, more exactly."""
        found: list[Minimum] = []
        for k, start in enumerate(starts):
            progress.step(k / len(starts), f"refining {k + 1} of {len(starts)}")
            minimum = self.polished(start, dense=len(starts) <= _N_DENSE)
            found += [] if minimum is None else [minimum]
        found.sort(key=lambda m: m.misfit_mm)
        for k, minimum in enumerate(found[: _N_DENSE if len(starts) > _N_DENSE else 0]):
            again = self.polished(minimum.fit.sensor_from_object, dense=True)
            if again is not None:
                found[k] = again
        return sorted(found, key=lambda m: m.misfit_mm)

    def outline(self, pose: Doubles, *, dense: bool = False) -> Judge:
        """A judge on the part of the object around the contact, so that its points lie dense there."""
        part = in_reach(self.scene, self.object.model, pose, _OUTLINE_REACH_MM)
        n_felt, n_model = (_DENSE_FELT, _DENSE_MODEL) if dense else (_OUTLINE_FELT, _OUTLINE_MODEL)
        return judge(self.scene, self.object.grid, part, n_felt, n_model, self.max_distance_mm)

    def determined(self, pose: Doubles) -> Observability:
        """From the object's normals where the scene lies on it, turned into the sensor frame."""
        points = self.scene.points_mm
        distance_mm, gradients = self.object.grid.at(rigid.apply(rigid.invert(pose), points))
        size = np.linalg.norm(gradients, axis=1, keepdims=True)
        normals = (gradients / np.maximum(size, 1e-12)) @ pose[:3, :3].T
        noise_mm = 1.4826 * float(np.median(np.abs(distance_mm)))  # robust: the rim of a contact is not noise
        # On a flat face's rim the wall beside it may be nearest, which was not felt and determines nothing.
        felt = np.einsum("ij,ij->i", normals, self.scene.normals) > _SAME_SURFACE
        if felt.sum() < _FEWEST:
            felt[:] = True
        n_eff = effective_count(int(felt.sum()), self.scene.area_mm2 * float(felt.mean()), CORRELATION_MM)
        return observability(
            points[felt], normals[felt], self.middle_mm, noise_mm, n_eff=n_eff, bias_mm=BIAS_MM
        )  # fmt: skip
