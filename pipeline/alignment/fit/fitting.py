"""The carrying that fits a few pairs: where to begin, least squares, and how far each number is to be trusted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.alignment.fit.agreement import compute_correlation, compute_mean_imprint, compute_residual
from pipeline.alignment.fit.transfer import FREE_PARAMETERS, ImprintPair, TransferModel, transfer_imprint
from pipeline.base.arrays import Doubles, Floats
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress

_FEWEST_FOR_A_MEAN = 6  # pairs, below which what they have in common is no more than one of them
_SCALES = (0.22, 0.38)  # of tiles, where no unit is shared
_BEGUN_DEG = 30  # between two turns that are tried
_BEGUN, _HOPEFUL = 3, 0.7  # beginnings that are followed at most, and how near to the best one they must do
_BEGUN_ON = 6  # pairs that they are judged by
_STEPS = {
    "rotation_rad": 0.05, "log_scale": 0.1, "tilt_right": 0.2, "tilt_down": 0.2, "rest_curvature": 0.1, "log_reach": 0.15,
    "log_width": 0.3, "log_stiffness": 0.5, "log_leak": 0.5,
}  # fmt: skip
_SHIFT_STEP = 0.02  # of the target's width
_ROUNDS = 10
_TOLD = {
    "rotation_rad": math.radians(5.0),
    "log_scale": 0.1,
    "tilt_right": 0.3,
    "tilt_down": 0.3,
    "rest_curvature": 0.3,
}  # still tells
_SHIFT_TOLD = 0.05  # of the target's width


@dataclass(frozen=True, slots=True, kw_only=True)
class PairsFit:
    """A carrying, what it rests on, and how it does."""

    transfer: TransferModel
    std: dict[str, float]  # standard deviations by field, from how single touches pull
    undetermined: tuple[str, ...]  # fields whose spread is beyond use
    mean_imprint: Doubles | None  # mean imprint of the pairs used, at their pictures' size; None = not taken away
    correlations: tuple[float, ...]  # correlation a pair, less `common` where there is one
    initial_guesses: tuple[tuple[str, float], ...]  # ways of laying that were tried, best first, and how they did


def fit_pairs(pairs: Sequence[ImprintPair], progress: Progress = SILENT) -> PairsFit:
    """The carrying for which expected and real imprints of `pairs` correlate best.

    Where there are enough pairs, their mean imprint is taken away first, so that only what differs between touches
    counts. Raises SettingProblem for fewer than two pairs, or where none has anything that touches.
    """
    kept = [p for p in pairs if p.contact.any() and float(np.ptp(p.imprint)) > 0]
    if len(kept) < 2:
        raise SettingProblem(f"an alignment needs at least two touches felt by both, got {len(kept)}")
    less_mean = len(kept) >= _FEWEST_FOR_A_MEAN and not kept[0].is_metric
    common = compute_mean_imprint([p.coarse_imprint for p in kept]) if less_mean else None
    real = [compute_residual(p.coarse_imprint, common) for p in kept]
    begun = _beginnings(kept[:_BEGUN_ON], real[:_BEGUN_ON], common, progress)
    best: tuple[float, TransferModel] | None = None
    hopeful = [how for score, how in begun[:_BEGUN] if score >= _HOPEFUL * begun[0][0]]
    for k, start in enumerate(hopeful):
        progress.step(0.3 + 0.6 * k / len(hopeful), "fitting")
        found = _Problem(kept, real, common).solve(start, progress)
        score = float(np.mean(_scores(kept, real, common, found)))
        if best is None or score > best[0]:
            best = (score, found)
    assert best is not None
    how = best[1]
    spread = _Problem(kept, real, common).std(how)
    width = kept[0].target_size[0]
    limits = {**_TOLD, "right": _SHIFT_TOLD * width, "down": _SHIFT_TOLD * width}
    whole = compute_mean_imprint([p.imprint for p in kept]) if less_mean else None
    ways: dict[str, float] = {}
    for score, start in begun:
        ways.setdefault(_said(start), score)
    return PairsFit(
        transfer=how, std=spread, undetermined=tuple(n for n, most in limits.items() if not spread[n] <= most),
        mean_imprint=whole, correlations=tuple(score_fit(p, how, whole) for p in kept), initial_guesses=tuple(ways.items()),
    )  # fmt: skip


def score_fit(pair: ImprintPair, how: TransferModel, common: Doubles | None) -> float:
    """Correlation of the expected imprint with the real one at the size of its picture, less `common` if given."""
    return compute_correlation(enlarge(transfer_imprint(pair, how), pair), pair.imprint, common)


def enlarge(coarse: Floats, pair: ImprintPair) -> Floats:
    """A picture of the coarse grid at the size of the pair's imprint."""
    import cv2

    rows, cols = pair.imprint.shape
    return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC), np.float32)


def _said(how: TransferModel) -> str:
    turn = round(math.degrees(how.rotation_rad)) % 360
    return f"{'mirrored, ' if how.is_mirrored else ''}turned by {turn} deg"


def _scores(
    pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None, how: TransferModel
) -> list[float]:
    return [float(compute_residual(transfer_imprint(p, how), common) @ r) for p, r in zip(pairs, real, strict=True)]


def _beginnings(
    pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None, progress: Progress
) -> list[tuple[float, TransferModel]]:
    """Every way of laying the source's picture, at the shift where the pairs agree best; best first."""
    scales = (1.0,) if pairs[0].is_metric else _SCALES
    found: list[tuple[float, TransferModel]] = []
    ways = list(itertools.product((False, True), range(0, 360, _BEGUN_DEG), scales))
    for k, (mirrored, turn, scale) in enumerate(ways):
        progress.step(0.3 * k / len(ways), "looking for a way to begin")
        how = TransferModel(
            is_mirrored=mirrored, rotation_rad=math.radians(turn), log_scale=math.log(scale), log_stiffness=0.5
        )
        how = _shifted(pairs, real, common, how)
        found.append((float(np.mean(_scores(pairs, real, common, how))), how))
    return sorted(found, key=lambda one: -one[0])


def _shifted(
    pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None, how: TransferModel
) -> TransferModel:
    """The same at the shift for which expected and real imprints correlate best, over all pairs at once."""
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
    """Residuals of all pairs: the real imprint less its best multiple of the expected one, both of unit length."""

    def __init__(self, pairs: Sequence[ImprintPair], real: Sequence[Doubles], common: Doubles | None) -> None:
        self._pairs, self._real, self._common = pairs, real, common
        width = pairs[0].target_size[0]
        # In millimetres a membrane's bridging would pass for another scale: it is 1 where both sides are metric.
        self._free = [n for n in FREE_PARAMETERS if n != "log_scale" or not pairs[0].is_metric]
        self._unit = np.array([_STEPS.get(n, _SHIFT_STEP * width) for n in self._free])

    def residuals(self, how: TransferModel) -> list[Doubles]:
        """A vector a pair, rather long: the cells of its coarse grid."""
        out: list[Doubles] = []
        for pair, r in zip(self._pairs, self._real, strict=True):
            e = compute_residual(transfer_imprint(pair, how), self._common)
            out.append(r - e * max(float(e @ r), 0.0))
        return out

    def solve(self, start: TransferModel, progress: Progress) -> TransferModel:
        """Damped Gauss-Newton from `start`; numbers that a step of theirs changes nothing of stay."""
        how, damping = start, 0.3
        rest = self.residuals(how)
        cost = sum(float(r @ r) for r in rest)
        for _ in range(_ROUNDS):
            progress.step(0.5, "fitting")
            slopes = self._slopes(how, rest)
            normal = sum((j.T @ j for j in slopes), np.zeros((len(self._unit),) * 2))
            pull = sum((j.T @ r for j, r in zip(slopes, rest, strict=True)), np.zeros(len(self._unit)))
            gained = 0.0
            for _ in range(4):
                step = -np.linalg.solve(normal + damping * (np.diag(np.diag(normal)) + 1e-3 * np.eye(len(pull))), pull)
                moved = self._moved(how, np.clip(np.asarray(step, np.float64), -3.0, 3.0))
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
        """Standard deviation of every number of the carrying: how differently the touches pull at it (sandwich)."""
        rest = self.residuals(how)
        slopes = self._slopes(how, rest)
        normal = sum((j.T @ j for j in slopes), np.zeros((len(self._unit),) * 2))
        pulls = np.array([j.T @ r for j, r in zip(slopes, rest, strict=True)])
        inverse = np.linalg.pinv(normal + 1e-9 * np.eye(len(normal)))
        n = len(self._pairs)
        covariance = inverse @ (pulls.T @ pulls) @ inverse * (n / max(1, n - 1))
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * self._unit
        felt = np.diag(normal) > 1e-9
        told = {n: float(d) if f else math.inf for n, d, f in zip(self._free, deviations, felt, strict=True)}
        return {n: told.get(n, 0.0) for n in FREE_PARAMETERS}

    def _moved(self, how: TransferModel, step: Doubles) -> TransferModel:
        at = {n: getattr(how, n) + float(s) for n, s in zip(self._free, step * self._unit, strict=True)}
        return replace(how, **at)

    def _slopes(self, how: TransferModel, rest: Sequence[Doubles]) -> list[Doubles]:
        """Derivatives (cells, numbers) of every pair's residuals, a small step of every number at a time."""
        columns: list[list[Doubles]] = []
        for k in range(len(self._free)):
            step = np.zeros(len(self._free))
            step[k] = 0.25
            moved = self.residuals(self._moved(how, step))
            columns.append([(m - r) / 0.25 for m, r in zip(moved, rest, strict=True)])
        return [np.stack([c[i] for c in columns], axis=1) for i in range(len(rest))]
