"""Table rows from scored touches: one per direction and candidate, with the paper's row."""

import math
import statistics
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.frozen import frozen
from pipeline.lab.evaluation.held_out import RECORDED, Candidate
from pipeline.lab.evaluation.published_results import MeanStd, PaperRow, Split, find_paper_row
from pipeline.lab.evaluation.touch_metrics import bootstrap_metrics, pool_metrics
from pipeline.lab.evaluation.touch_scoring import PAPER_GRASP, GraspFinger, ScoredTouch
from pipeline.stages.pose.registration.planar import compute_grasp_pose_error


@frozen
class PoseErrors:
    """Errors of object poses that are estimated from touches."""

    translation_mm: MeanStd  # mean and standard deviation in the target's image plane
    rotation_deg: MeanStd
    n_poses: int  # touches that gave a pose


@frozen
class SetDistances:
    """Distances of the generated touches to the recorded ones.

    The floor is between halves of the recorded.
    """

    frechet: float
    frechet_floor: float
    kernel: float  # 0 = equal sets


@frozen
class TableRow:
    """Errors of one method, between two sensors, over a set of touches."""

    source: str
    target: str
    candidate: str
    title: str
    n_touches: int
    metrics: Mapping[str, Mapping[str, float]]  # TOUCH_METRICS name -> region -> value
    # the same -> 95 % interval over grasps, where known
    intervals: Mapping[str, Mapping[str, tuple[float, float]]]
    pose_errors: Mapping[str, PoseErrors]  # pose method -> errors
    set_distances: SetDistances | None  # None = no encoder for this target, or too few touches
    ms: float  # median time per touch
    paper: PaperRow | None
    notes: tuple[str, ...]


def build_rows(
    split: Split,
    source: str,
    target: str,
    candidates: Sequence[Candidate],
    scored: Sequence[ScoredTouch],
) -> list[TableRow]:
    """Rows of one direction in the order of the candidates; recorded touches have poses only."""
    by_candidate = {
        c.name: [touch for touch in scored if touch.candidate == c.name] for c in candidates
    }
    true = _stack_features(by_candidate.get(RECORDED, []))
    rows: list[TableRow] = []
    for candidate in candidates:
        touches = by_candidate[candidate.name]
        if not touches:
            continue
        is_recorded = candidate.name == RECORDED
        row_source = "" if is_recorded else source
        rows.append(
            TableRow(
                source=row_source,
                target=target,
                candidate=candidate.name,
                title=candidate.title,
                n_touches=len(touches),
                metrics=pool_metrics([touch.metrics for touch in touches]),
                intervals=bootstrap_metrics(
                    [touch.metrics for touch in touches], [touch.touch_name for touch in touches]
                ),
                pose_errors=_pool_pose_errors(touches),
                set_distances=None
                if is_recorded or true is None
                else _compare_sets(_stack_features(touches), true),
                ms=statistics.median(touch.ms for touch in touches),
                notes=tuple(dict.fromkeys(note for touch in touches for note in touch.notes)),
                paper=find_paper_row(split, row_source, target, candidate.paper_model)
                if is_recorded or candidate.paper_model
                else None,
            )
        )
    return rows


def _stack_features(touches: Sequence[ScoredTouch]) -> Doubles | None:
    """(touches, features) of all touches; None without encoder."""
    features = [touch.features for touch in touches if touch.features is not None]
    return np.array(features, np.float64) if features and len(features) == len(touches) else None


def _compare_sets(generated: Doubles | None, true: Doubles) -> SetDistances | None:
    if generated is None or len(generated) != len(true) or len(true) < 2 * MIN_TOUCHES:
        return None
    return SetDistances(
        frechet=compare_halves(frechet_distance, generated, true),
        frechet_floor=compare_halves(frechet_distance, true, true),
        kernel=kernel_distance(generated, true),
    )


def _pool_pose_errors(touches: Sequence[ScoredTouch]) -> dict[str, PoseErrors]:
    pooled: dict[str, PoseErrors] = {}
    for method in dict.fromkeys(name for touch in touches for name in touch.pose_errors):
        errors = [touch.pose_errors[method] for touch in touches if method in touch.pose_errors]
        lengths_mm, angles_deg = ([e[k] for e in errors if math.isfinite(e[k])] for k in (0, 1))
        if lengths_mm and angles_deg:
            pooled[method] = _pool_errors(lengths_mm, angles_deg)
    return pooled | _pool_grasp_errors(touches)


def _pool_grasp_errors(touches: Sequence[ScoredTouch]) -> dict[str, PoseErrors]:
    """Errors of poses from the fingers of each grasp together; {} where no grasp frame is known."""
    grasps: dict[str, list[GraspFinger]] = {}
    for touch in touches:
        if touch.finger is not None:
            grasps.setdefault(touch.touch_name, []).append(touch.finger)
    errors = [
        compute_grasp_pose_error(
            np.concatenate([f.points_mm for f in fingers]),
            fingers[0].mesh,
            fingers[0].grasp_from_object,
        )
        for fingers in grasps.values()
    ]
    known = [error for error in errors if error is not None]
    if not known:
        return {}
    lengths_mm, angles_deg = ([e.translation_mm for e in known], [e.rotation_deg for e in known])
    return {PAPER_GRASP: _pool_errors(lengths_mm, angles_deg)}


def _pool_errors(lengths_mm: Sequence[float], angles_deg: Sequence[float]) -> PoseErrors:
    translation_mm, rotation_deg = (
        (statistics.fmean(values), statistics.pstdev(values)) for values in (lengths_mm, angles_deg)
    )
    return PoseErrors(
        translation_mm=translation_mm, rotation_deg=rotation_deg, n_poses=len(lengths_mm)
    )


MIN_TOUCHES = 4  # touches of a set needed for a covariance
Distance = Callable[[Doubles, Doubles], float]


def frechet_distance(a: Doubles, b: Doubles) -> float:
    """Return the squared Frechet distance (>= 0) of normal distributions fitted to rows (n,
    features).

    With few touches it is mostly its own bias, so it is only meaningful relative to that of two
    halves of the true set.

    tr((S T)^1/2) of two covariances is the nuclear norm of the product of their factors, exact also
    for fewer touches than features; NaN for fewer than `MIN_TOUCHES`.
    """
    if min(len(a), len(b)) < MIN_TOUCHES:
        return math.nan
    shift = a.mean(axis=0) - b.mean(axis=0)
    one, other = (_factor(x) for x in (a, b))
    joint = float(np.linalg.svd(one @ other.T, compute_uv=False).sum())
    return max(0.0, float(shift @ shift) + float((one**2).sum() + (other**2).sum()) - 2.0 * joint)


def _factor(x: Doubles) -> Doubles:
    """Return R with R^T R the covariance of the rows of `x`, of minimal size."""
    return np.asarray(
        np.linalg.qr((x - x.mean(axis=0)) / math.sqrt(len(x) - 1), mode="r"), np.float64
    )


def kernel_distance(generated: Doubles, true: Doubles) -> float:
    """Return the unbiased squared maximum mean discrepancy of paired rows (n, features) of both
    sets; 0 = equal sets.

    The cubic kernel of Binkowski et al. 2018, (x.y / scale + 1)^3, where the scale is the mean
    squared length of the true features instead of their number: ours are thirty times as large as
    Inception's. Row i of both sets is the same touch, so that every mean is over the pairs i != j
    (Gretton et al. 2012, lemma 6): objects occur equally often in all terms, and no touch is set
    aside for a floor. NaN for fewer than `MIN_TOUCHES`.
    """
    n = len(true)
    if min(n, len(generated)) < MIN_TOUCHES:
        return math.nan
    scale = float((true**2).sum(axis=1).mean()) or 1.0

    def average_kernel(x: Doubles, y: Doubles) -> float:
        k = (x @ y.T / scale + 1.0) ** 3
        return float((k.sum() - np.trace(k)) / (n * (n - 1)))

    return (
        average_kernel(generated, generated)
        + average_kernel(true, true)
        - 2.0 * average_kernel(generated, true)
    )


def compare_halves(distance: Distance, generated: Doubles, true: Doubles) -> float:
    """Return the mean distance of one half of the generated set to the other half of the true set,
    both ways.

    Rows are pairs; the two halves share no touch. Of the true set with itself it is the best
    possible value, with the same bias.
    """
    return 0.5 * (distance(generated[0::2], true[1::2]) + distance(generated[1::2], true[0::2]))
