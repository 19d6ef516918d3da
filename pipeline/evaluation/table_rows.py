"""Table rows from scored touches: one per direction and candidate, with the paper's row."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.evaluation.candidates import RECORDED, Candidate
from pipeline.evaluation.published_results import MeanStd, PaperRow, Split, find_paper_row
from pipeline.evaluation.touch_metrics import bootstrap_metrics, pool_metrics
from pipeline.evaluation.touch_scoring import PAPER_GRASP, GraspFinger, ScoredTouch
from pipeline.metrics import set_distances
from pipeline.registration.grasp_pose import compute_grasp_pose_error


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Errors of object poses that are estimated from touches."""

    translation_mm: MeanStd  # mean and standard deviation in the target's image plane
    rotation_deg: MeanStd
    n_poses: int  # touches that gave a pose


@dataclass(frozen=True, slots=True, kw_only=True)
class SetDistances:
    """Distances of the generated touches to the recorded ones; the floor is between halves of the recorded."""

    frechet: float
    frechet_floor: float
    kernel: float  # 0 = equal sets


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRow:
    """Errors of one method, between two sensors, over a set of touches."""

    source: str
    target: str
    candidate: str
    title: str
    n_touches: int
    metrics: Mapping[str, Mapping[str, float]]  # TOUCH_METRICS name -> region -> value
    intervals: Mapping[str, Mapping[str, tuple[float, float]]]  # the same -> 95 % interval over grasps, where known
    pose_errors: Mapping[str, PoseErrors]  # pose method -> errors
    set_distances: SetDistances | None  # None = no encoder for this target, or too few touches
    ms: float  # median time per touch
    paper: PaperRow | None
    notes: tuple[str, ...]


def build_rows(
    split: Split, source: str, target: str, candidates: Sequence[Candidate], scored: Sequence[ScoredTouch]
) -> list[TableRow]:
    """Rows of one direction in the order of the candidates; recorded touches have poses only."""
    by_candidate = {c.name: [touch for touch in scored if touch.candidate == c.name] for c in candidates}
    true = _stack_features(by_candidate.get(RECORDED, []))
    rows: list[TableRow] = []
    for candidate in candidates:
        touches = by_candidate[candidate.name]
        if not touches:
            continue
        is_recorded = candidate.name == RECORDED
        row_source = "" if is_recorded else source
        rows.append(TableRow(
            source=row_source, target=target, candidate=candidate.name, title=candidate.title,
            n_touches=len(touches), metrics=pool_metrics([touch.metrics for touch in touches]),
            intervals=bootstrap_metrics([touch.metrics for touch in touches], [touch.touch_name for touch in touches]),
            pose_errors=_pool_pose_errors(touches),
            set_distances=None if is_recorded or true is None else _compare_sets(_stack_features(touches), true),
            ms=statistics.median(touch.ms for touch in touches),
            notes=tuple(dict.fromkeys(note for touch in touches for note in touch.notes)),
            paper=find_paper_row(split, row_source, target, candidate.paper_model)
            if is_recorded or candidate.paper_model else None,
        ))  # fmt: skip
    return rows


def _stack_features(touches: Sequence[ScoredTouch]) -> Doubles | None:
    """(touches, features) of all touches; None without encoder."""
    features = [touch.features for touch in touches if touch.features is not None]
    return np.array(features, np.float64) if features and len(features) == len(touches) else None


def _compare_sets(generated: Doubles | None, true: Doubles) -> SetDistances | None:
    if generated is None or len(generated) != len(true) or len(true) < 2 * set_distances.MIN_TOUCHES:
        return None
    return SetDistances(
        frechet=set_distances.compare_halves(set_distances.frechet_distance, generated, true),
        frechet_floor=set_distances.compute_floor(set_distances.frechet_distance, true),
        kernel=set_distances.kernel_distance(generated, true),
    )


def _pool_pose_errors(touches: Sequence[ScoredTouch]) -> dict[str, PoseErrors]:
    pooled: dict[str, PoseErrors] = {}
    for method in dict.fromkeys(name for touch in touches for name in touch.pose_errors):
        errors = [touch.pose_errors[method] for touch in touches if method in touch.pose_errors]
        lengths_mm, angles_deg = ([e[k] for e in errors if math.isfinite(e[k])] for k in (0, 1))
        if lengths_mm and angles_deg:
            pooled[method] = PoseErrors(
                translation_mm=_mean_std(lengths_mm), rotation_deg=_mean_std(angles_deg), n_poses=len(lengths_mm)
            )
    return pooled | _pool_grasp_errors(touches)


def _pool_grasp_errors(touches: Sequence[ScoredTouch]) -> dict[str, PoseErrors]:
    """Errors of poses from the fingers of each grasp together; {} where no grasp frame is known."""
    grasps: dict[str, list[GraspFinger]] = {}
    for touch in touches:
        if touch.finger is not None:
            grasps.setdefault(touch.touch_name, []).append(touch.finger)
    errors = [
        compute_grasp_pose_error(
            np.concatenate([f.points_mm for f in fingers]), fingers[0].mesh, fingers[0].grasp_from_object
        )
        for fingers in grasps.values()
    ]
    known = [error for error in errors if error is not None]
    if not known:
        return {}
    return {PAPER_GRASP: PoseErrors(
        translation_mm=_mean_std([e.translation_mm for e in known]),
        rotation_deg=_mean_std([e.rotation_deg for e in known]), n_poses=len(known),
    )}  # fmt: skip


def _mean_std(values: Sequence[float]) -> MeanStd:
    return statistics.fmean(values), statistics.pstdev(values)
