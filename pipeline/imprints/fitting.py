"""Fit a transfer model to a few imprint pairs: initial guesses, least squares, and standard deviations."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress
from pipeline.imprints.agreement import compute_correlation, compute_mean_imprint, compute_residual
from pipeline.imprints.transfer import FREE_PARAMETERS, ImprintPair, TransferModel, transfer_imprint

_MIN_PAIRS_FOR_MEAN = 6  # pairs needed to subtract their mean imprint
_SCALES = (0.22, 0.38)  # of tiles, which share no unit
_START_STEP_DEG = 30  # between two rotations tried
_MAX_STARTS, _MIN_START_SHARE = 3, 0.7  # starts fitted at most, and their share of the best start's correlation
_START_PAIRS = 6  # pairs that starts are compared on
_STEPS = {
    "rotation_rad": 0.05, "log_scale": 0.1, "tilt_right": 0.2, "tilt_down": 0.2, "rest_curvature": 0.1,
    "log_reach": 0.15,    "log_width": 0.3, "log_stiffness": 0.5, "log_leak": 0.5,
}  # fmt: skip
_SHIFT_STEP = 0.02  # of the target's width
_MAX_ITERATIONS = 10
_MAX_STD = {
    "rotation_rad": math.radians(5.0),
    "log_scale": 0.1,
    "tilt_right": 0.3,
    "tilt_down": 0.3,
    "rest_curvature": 0.3,
}  # largest std of a determined parameter
_MAX_SHIFT_STD = 0.05  # of the target's width


@dataclass(frozen=True, slots=True, kw_only=True)
class PairsFit:
    """A fitted transfer model, its uncertainty and its correlations."""

    transfer: TransferModel
    std: dict[str, float]  # by field, from the scatter of single touches
    undetermined: tuple[str, ...]  # fields whose std is too large
    mean_imprint: Doubles | None  # mean imprint of the pairs, at full image size; None = not subtracted
    correlations: tuple[float, ...]  # per pair, with `mean_imprint` regressed out if given
    initial_guesses: tuple[tuple[str, float], ...]  # orientations tried, best first, and their correlation


def fit_pairs(pairs: Sequence[ImprintPair], progress: Progress = SILENT) -> PairsFit:
    """Fit the transfer model for which expected and recorded imprints of `pairs` correlate best.

    With enough pairs their mean imprint is subtracted first, so that only differences between touches count. Raises
    SettingProblem for fewer than two pairs with contact.
    """
    kept = [p for p in pairs if p.contact.any() and float(np.ptp(p.imprint)) > 0]
    if len(kept) < 2:
        raise SettingProblem(f"an alignment needs at least two touches with contact on both sensors, got {len(kept)}")
    less_mean = len(kept) >= _MIN_PAIRS_FOR_MEAN and not kept[0].is_metric
    common = compute_mean_imprint([p.coarse_imprint for p in kept]) if less_mean else None
    real = [compute_residual(p.coarse_imprint, common) for p in kept]
    starts = _rank_orientations(kept[:_START_PAIRS], real[:_START_PAIRS], common, progress)
    best: tuple[float, TransferModel] | None = None
    promising = [how for score, how in starts[:_MAX_STARTS] if score >= _MIN_START_SHARE * starts[0][0]]
    for k, start in enumerate(promising):
        progress.step(0.3 + 0.6 * k / len(promising), "fitting")
        found = _Problem(kept, real, common).solve(start, progress)
        score = float(np.mean(_scores(kept, real, common, found)))
        if best is None or score > best[0]:
            best = (score, found)
    assert best is not None
    how = best[1]
    spread = _Problem(kept, real, common).std(how)
    width = kept[0].target_size[0]
    limits = {**_MAX_STD, "right": _MAX_SHIFT_STD * width, "down": _MAX_SHIFT_STD * width}
    whole = compute_mean_imprint([p.imprint for p in kept]) if less_mean else None
    orientations: dict[str, float] = {}
    for score, start in starts:
        orientations.setdefault(_describe_orientation(start), score)
    return PairsFit(
        transfer=how, std=spread, undetermined=tuple(n for n, most in limits.items() if not spread[n] <= most),
        mean_imprint=whole, correlations=tuple(score_fit(p, how, whole) for p in kept),
        initial_guesses=tuple(orientations.items()),
    )  # fmt: skip


def score_fit(pair: ImprintPair, how: TransferModel, common: Doubles | None) -> float:
    """Return the correlation of expected and recorded imprint at full size, with `common` regressed out if given."""
    return compute_correlation(enlarge(transfer_imprint(pair, how), pair), pair.imprint, common)


def enlarge(coarse: Floats, pair: ImprintPair) -> Floats:
    """Resize an image of the coarse grid to the size of the pair's imprint."""
    import cv2

    rows, cols = pair.imprint.shape
    return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), np.float32)


def _describe_orientation(how: TransferModel) -> str:
    turn = round(math.degrees(how.rotation_rad)) % 360
    return f"{'mirrored, ' if how.is_mirrored else ''}rotated by {turn} deg"


def _scores(
    pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None, how: TransferModel
) -> list[float]:
    return [float(compute_residual(transfer_imprint(p, how), common) @ r) for p, r in zip(pairs, real, strict=True)]


def _rank_orientations(
    pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None, progress: Progress
) -> list[tuple[float, TransferModel]]:
    """Return all orientations of the source's image at their best translation; best first."""
    scales = (1.0,) if pairs[0].is_metric else _SCALES
    found: list[tuple[float, TransferModel]] = []
    orientations = list(itertools.product((False, True), range(0, 360, _START_STEP_DEG), scales))
    for k, (mirrored, turn, scale) in enumerate(orientations):
        progress.step(0.3 * k / len(orientations), "searching for an initial orientation")
        how = TransferModel(
            is_mirrored=mirrored, rotation_rad=math.radians(turn), log_scale=math.log(scale), log_stiffness=0.5
        )
        how = _translate_to_best(pairs, real, common, how)
        found.append((float(np.mean(_scores(pairs, real, common, how))), how))
    return sorted(found, key=lambda one: -one[0])


def _translate_to_best(
    pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None, how: TransferModel
) -> TransferModel:
    """Translate the model to the best correlation of expected and recorded imprints, over all pairs at once."""
    rows, cols = pairs[0].cells
    total = np.zeros((2 * rows, 2 * cols))
    for pair, r in zip(pairs, real, strict=True):
        e = compute_residual(transfer_imprint(pair, how), common).reshape(rows, cols)
        there, expected = (np.fft.rfft2(np.asarray(a).reshape(rows, cols), total.shape) for a in (r, e))
        total += np.fft.irfft2(there * np.conj(expected), total.shape)
    down, right = (int(k) for k in np.unravel_index(int(np.argmax(total)), total.shape))
    down, right = (k - 2 * n if k >= n else k for k, n in ((down, rows), (right, cols)))
    width, height = pairs[0].target_size
    return replace(how, right=how.right + right * width / cols, down=how.down + down * height / rows)


class _Problem:
    """Residuals of all pairs: the recorded imprint less its best multiple of the expected one, both of unit length."""

    def __init__(self, pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None) -> None:
        self._pairs, self._real, self._common = pairs, real, common
        width = pairs[0].target_size[0]
        # In millimetres a membrane's bridging would look like another scale: it is 1 where both sides are metric.
        self._free = [n for n in FREE_PARAMETERS if n != "log_scale" or not pairs[0].is_metric]
        self._unit = np.array([_STEPS.get(n, _SHIFT_STEP * width) for n in self._free])

    def residuals(self, how: TransferModel) -> list[Doubles]:
        """Return one vector per pair: the cells of its coarse grid."""
        out: list[Doubles] = []
        for pair, r in zip(self._pairs, self._real, strict=True):
            e = compute_residual(transfer_imprint(pair, how), self._common)
            out.append(r - e * max(float(e @ r), 0.0))
        return out

    def solve(self, start: TransferModel, progress: Progress) -> TransferModel:
        """Damped Gauss-Newton from `start`; parameters without effect keep their values."""
        how, damping = start, 0.3
        rest = self.residuals(how)
        cost = sum(float(r @ r) for r in rest)
        for _ in range(_MAX_ITERATIONS):
            progress.step(0.5, "fitting")
            slopes = self._slopes(how, rest)
            normal = sum((j.T @ j for j in slopes), np.zeros((len(self._unit),) * 2))
            pull = sum((j.T @ r for j, r in zip(slopes, rest, strict=True)), np.zeros(len(self._unit)))
            gained = 0.0
            for _ in range(4):
                step = -np.linalg.solve(normal + damping * (np.diag(np.diag(normal)) + 1e-3 * np.eye(len(pull))), pull)
                moved = self._apply_step(how, np.clip(np.asarray(step, np.float64), -3.0, 3.0))
                there = self.residuals(moved)
                lower = sum(float(r @ r) for r in there)
                if lower < cost:
                    gained, how, rest, cost, damping = cost - lower, moved, there, lower, damping / 3
                    break
                damping *= 4
            if gained < 2e-4 * cost:
                break
        return how

    def std(self, how: TransferModel) -> dict[str, float]:
        """Return each parameter's standard deviation from the scatter of the touches (sandwich estimator)."""
        rest = self.residuals(how)
        slopes = self._slopes(how, rest)
        normal = sum((j.T @ j for j in slopes), np.zeros((len(self._unit),) * 2))
        pulls = np.array([j.T @ r for j, r in zip(slopes, rest, strict=True)])
        inverse = np.linalg.pinv(normal + 1e-9 * np.eye(len(normal)))
        n = len(self._pairs)
        covariance = inverse @ (pulls.T @ pulls) @ inverse * (n / max(1, n - 1))
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * self._unit
        is_sensitive = np.diag(normal) > 1e-9
        deviation_by_name = {
            n: float(d) if f else math.inf for n, d, f in zip(self._free, deviations, is_sensitive, strict=True)
        }
        return {n: deviation_by_name.get(n, 0.0) for n in FREE_PARAMETERS}

    def _apply_step(self, how: TransferModel, step: Doubles) -> TransferModel:
        at = {n: getattr(how, n) + float(s) for n, s in zip(self._free, step * self._unit, strict=True)}
        return replace(how, **at)

    def _slopes(self, how: TransferModel, rest: Sequence[Doubles]) -> list[Doubles]:
        """Return derivatives (cells, parameters) of every pair's residuals by finite differences."""
        columns: list[list[Doubles]] = []
        for k in range(len(self._free)):
            step = np.zeros(len(self._free))
            step[k] = 0.25
            moved = self.residuals(self._apply_step(how, step))
            columns.append([(m - r) / 0.25 for m, r in zip(moved, rest, strict=True)])
        return [np.stack([c[i] for c in columns], axis=1) for i in range(len(rest))]
