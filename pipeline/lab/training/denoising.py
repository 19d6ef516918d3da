"""Tasks that train a denoiser of the target's touch: touch to depth to touch on touches of the
target alone, touch to touch on pairs.

At the largest noise level the network sees the condition alone (zero terminal signal, Lin et al.
2024), and one step gives the posterior mean. Errors count there as squares where they are small and
linearly where they are large (Huber), so that a body which is rarely present moves the mean less.
At smaller noise levels they count as squares: samples then follow the mean of what is possible,
while those trained toward its median hardly differ. A gel's image shows slopes: squared errors of
slopes make one step the mean of all images, without edges at unknown positions.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Floats
from pipeline.core.frozen import frozen
from pipeline.core.params import setting
from pipeline.lab.training.distributed import unwrap_network
from pipeline.lab.training.recorded_pairs import RecordedPair, derive_contact
from pipeline.lab.training.simulated_touches import (
    BUBBLE,
    GEL,
    DataSplit,
    find_next_contact,
    flip_arrays,
    mirror_pair,
    place_nominal_sensors,
    simulate_target_touch,
    simulate_touch_pair,
)
from pipeline.lab.training.task import (
    VALIDATION_SEED,
    AugmentedPresses,
    TargetSensor,
    average_rows,
    weigh_terms,
)
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import photometric as depth
from pipeline.stages.metrics.stage_metrics import iou
from pipeline.stages.networks.samplers import make_sigma_schedule, sample
from pipeline.stages.networks.touch_formats import get_touch_format
from pipeline.stages.touch import t2t
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.stages.touch.residual_diffusion import (
    LOG_ERROR_RANGE,
    resample_to_grid,
)
from pipeline.stages.touch.t2d2 import build_depth_condition, make_working_sensor

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

_TERMINAL_SHARE = 0.5  # examples at the largest noise level
_LOG_SIGMA = 0.0, 1.5  # mean and standard deviation of the logarithm of all other noise levels
_CONDITION_DROPOUT = 0.1
_HUBER = 0.25  # in units of the residual
# weights in the loss
_CONTACT_TERM = 0.5
_UNCERTAINTY_TERM = 0.05
_N_SAMPLE_STEPS = 6  # of the samples in the metrics
# of recorded pairs; the last in shares of the image's rows
_MAX_ROTATION_DEG = 5.0
_MAX_SCALING = 0.05
_MAX_BRIGHTENING = 0.25
GELS = (GEL, "gelsight_mini")  # sources of training pairs, and the share of the second
_OTHER_GEL_SHARE = 0.25
_DRIFT_GREY = 2.0  # standard deviation of a change of light since the reference image
_MAX_TRANSLATION = 0.03


@frozen
class DenoisingTask(AugmentedPresses):
    """Settings of every task whose network denoises a residual of the target's touch."""

    slope_weight: float = setting(
        0.0, "Slope weight", low=0.0, high=1000.0, help="of the slopes a gel's image shows"
    )
    uncertainty_only: bool = setting(
        False,
        "Uncertainty only",
        help="trains the predicted error alone, on touches that nothing else was trained on",
    )

    @property
    @abstractmethod
    def kind(self) -> str:
        """Kind of the target."""

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """See `compute_denoising_loss` and `compute_uncertainty_loss`."""
        if self.uncertainty_only:
            return compute_uncertainty_loss(network, batch)
        return compute_denoising_loss(network, batch, self.slope_weight)

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Errors in mm, in the target's contact and over all, and contact IoU: of one step, of a
        sample and of no prediction.

        The last is physics for touch to depth to touch, and the untouched target for touch to
        touch.
        """
        import torch

        from pipeline.stages.networks.residual_denoiser import correlate_noise

        net = unwrap_network(network)
        unit_mm = get_touch_format(self.kind).residual_unit_mm
        levels = make_sigma_schedule(
            _N_SAMPLE_STEPS, sigma_max=net.sigma_max, sigma_min=net.sigma_min
        )
        rows: list[dict[str, float]] = []
        for k, example in enumerate(held_out):
            condition = torch.tensor(example["condition"])[None, : net.inputs]
            white = torch.randn(
                (1, *example["residual"].shape), generator=torch.Generator().manual_seed(k)
            )
            noise = correlate_noise(white, net.noise_correlation)

            def denoise(noisy: Tensor, sigma: float, condition: Tensor = condition) -> Tensor:
                return network(noisy, torch.full((1,), sigma), condition)[:, :2]

            with torch.inference_mode():
                step = denoise(noise * net.sigma_max, net.sigma_max)
                predictions = {"": step, "sample ": sample(denoise, noise, levels).clean}
            has_contact, baseline = example["contact"]
            row: dict[str, float] = {}
            for which, prediction in {**predictions, "no-prediction ": 0.0 * step}.items():
                field, change = prediction[0].numpy()
                error = unit_mm * np.abs(field - example["residual"][0])
                in_contact = (error * has_contact).sum() / max(has_contact.sum(), 1.0)
                row |= {
                    f"{which}error in contact, mm": in_contact,
                    f"{which}error over all, mm": error.mean(),
                    f"{which}contact IoU": iou(baseline + change > 0.5, has_contact > 0),
                }
            rows.append(row)
        return average_rows(rows)


@frozen
class TouchResidualTask(DenoisingTask):
    """Touch to depth to touch: what the physical render misses."""

    target: TargetSensor = setting(BUBBLE, "Target", choices=TargetSensor)

    @property
    def kind(self) -> str:
        """Kind of the target."""
        return load_sensor(self.target).kind

    def sample(self, rng: np.random.Generator) -> Example:
        """A touch, rotated by 180 degrees or mirrored in a share of the examples."""
        example = self._make_example("training", self.press_seed, int(rng.integers(self.n_presses)))
        if rng.random() >= self.augmentation_share:
            return example
        return flip_arrays(example, ((-1,), (-2,), (-2, -1))[int(rng.integers(3))])

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        return self._make_example(split, VALIDATION_SEED, index)

    def _make_example(self, split: DataSplit, seed: int, index: int) -> Example:
        touch = find_next_contact(
            lambda k: simulate_target_touch(self.target, split, seed, k, self.folder),
            index,
            "no source observes any of",
        )
        condition = build_depth_condition(
            self.kind,
            touch.observed_mm,
            touch.observed,
            touch.in_view,
            touch.physical_mm,
            touch.physical_contact,
        )
        return make_residual_example(
            condition,
            touch.target_mm - touch.physical_mm,
            touch.target_contact,
            self.kind,
            touch.physical_contact,
        )


@frozen
class TouchToTouchTask(DenoisingTask):
    """Touch to touch, from a gel to a bubble."""

    @property
    def kind(self) -> str:
        """Kind of the target."""
        return "bubble"

    def sample(self, rng: np.random.Generator) -> Example:
        """A pair whose image is stronger or weaker and has drifted, mirrored in a share.

        A gel's image is rendered anew, as its LEDs are asymmetric.
        """
        index = int(rng.integers(self.n_presses))
        return self._make_example("training", self.press_seed, index, rng, self.augmentation_share)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        return self._make_example(
            split, VALIDATION_SEED, index, np.random.default_rng([17, index]), 0.0
        )

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """Names of source and target."""
        return GEL, BUBBLE

    def prepare_pair(self, pair: RecordedPair) -> Example | None:
        """The example of a recorded pair; None where one of the sensors is untouched."""
        params = depth.DepthParams()
        frame = pair.target_frame
        if depth.skip_without_contact(pair.source_frame, pair.source, None, params) is not None:
            return None
        truth = pair.target_truth
        if truth is not None and truth.indentation_mm is not None:
            touch = truth.indentation_mm
            contact = derive_contact(truth, pair.target)
        elif depth.skip_without_contact(frame, pair.target, None, params) is None:
            estimate = depth.estimate_depth(frame, pair.target, None, params)
            touch = np.nan_to_num(estimate.indentation_mm)
            contact = estimate.contact
        else:
            return None
        if not contact.any():
            return None
        shape = make_working_sensor(pair.target).camera.shape
        return make_residual_example(
            t2t.build_condition(pair.source_frame, pair.source, pair.alignment, pair.target),
            resample_to_grid(touch, shape),
            resample_to_grid(contact, shape) > 0.5,
            self.kind,
        )

    def make_pair_example(
        self, prepared: Example, rng: np.random.Generator, *, is_validation: bool
    ) -> Example:
        """A recorded pair, moved, rotated and brightened a little unless it validates."""
        return prepared if is_validation else jitter_example(prepared, rng)

    def _make_example(
        self, split: DataSplit, seed: int, index: int, rng: np.random.Generator, mirrored: float
    ) -> Example:
        is_training = seed != VALIDATION_SEED
        name = GELS[int(is_training and rng.random() < _OTHER_GEL_SHARE)]
        pair = find_next_contact(
            lambda k: simulate_touch_pair(split, seed, k, self.folder, gel=name),
            index,
            "the gel has no contact in",
        )
        if rng.random() < mirrored:
            pair = mirror_pair(pair, rng, name)
        gel, bubble = place_nominal_sensors(pair.placement, name)
        change = pair.change_grey + rng.standard_normal(pair.change_grey.shape, np.float32)
        if is_training:
            change = _drift(change, rng)
        between = alignment.resolve_alignment(gel, bubble)
        condition = build_image_condition(change, gel.camera, gel, bubble, between)
        return make_residual_example(condition, pair.bubble_mm, pair.bubble_contact, self.kind)


def _drift(change_grey: Floats, rng: np.random.Generator) -> Floats:
    """The change of a stronger or weaker image whose light has changed since its reference."""
    import cv2

    light = cv2.resize(rng.normal(0.0, _DRIFT_GREY, (2, 3, 3)), change_grey.shape[1::-1])
    strength = 1.0 + rng.uniform(-_MAX_BRIGHTENING, _MAX_BRIGHTENING)
    return (strength * change_grey + light).astype(np.float32)


def make_residual_example(
    condition: Floats, residual_mm: Floats, contact: Any, kind: str, baseline: Any = None
) -> Example:
    """Condition, residual and contact of a denoiser.

    contact: where the target has contact; baseline: where the physical render has, None = nowhere.
    The residual (2, rows, cols) is that of indentation, in units of `TouchFormat.residual_unit_mm`,
    and that of contact.
    """
    true = contact.astype(np.float32)
    physical = 0.0 * true if baseline is None else baseline.astype(np.float32)
    unit_mm = np.float32(get_touch_format(kind).residual_unit_mm)
    return {
        "condition": np.ascontiguousarray(condition),
        "residual": np.stack([residual_mm / unit_mm, true - physical]).astype(np.float32),
        "contact": np.stack([true, physical]),
    }


def jitter_example(example: Example, rng: np.random.Generator) -> Example:
    """A pair's example slightly rotated, scaled and translated, its source's change stronger or
    weaker.
    """
    import cv2

    rows, cols = example["contact"].shape[1:]
    angle_deg = rng.uniform(-_MAX_ROTATION_DEG, _MAX_ROTATION_DEG)
    scale = 1.0 + rng.uniform(-_MAX_SCALING, _MAX_SCALING)
    matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle_deg, scale)
    matrix[:, 2] += rng.uniform(-_MAX_TRANSLATION, _MAX_TRANSLATION, 2) * rows

    def warp(fields: Floats) -> Floats:
        warped = [
            cv2.warpAffine(field, matrix, (cols, rows), borderMode=cv2.BORDER_REPLICATE)
            for field in fields
        ]
        return np.stack(warped).astype(np.float32)

    condition = warp(example["condition"])
    # view and overlap are no colours
    condition[:-2] *= np.float32(1.0 + rng.uniform(-_MAX_BRIGHTENING, _MAX_BRIGHTENING))
    contact = np.round(warp(example["contact"]))
    residual = np.stack([warp(example["residual"][:1])[0], contact[0]])
    return {"condition": condition, "residual": residual, "contact": contact}


def compute_denoising_loss(
    network: nn.Module,
    batch: Mapping[str, Tensor],
    slope_weight: float,
) -> tuple[Tensor, dict[str, Any]]:
    """Error of the clean residual, and likelihood of the predicted uncertainty.

    `slope_weight`: weight of squared differences between neighbouring pixels' errors.
    """
    import torch
    from torch.nn import functional

    from pipeline.stages.networks.residual_denoiser import correlate_noise

    net = unwrap_network(network)
    clean = batch["residual"]
    condition = batch["condition"][:, : net.inputs]  # older weights know no placement

    def per_example(values: Tensor) -> Tensor:
        return values.to(clean.device).reshape(-1, 1, 1)

    n = len(clean)
    level = torch.exp(torch.empty(n).normal_(*_LOG_SIGMA)).clamp(
        net.sigma_min, 0.999 * net.sigma_max
    )
    terminal = torch.rand(n) < _TERMINAL_SHARE
    sigma = torch.where(terminal, torch.full((n,), float(net.sigma_max)), level).to(clean.device)
    kept = (torch.rand(n) >= _CONDITION_DROPOUT).float()
    noise = correlate_noise(torch.randn_like(clean), net.noise_correlation)
    prediction = network(
        clean + per_example(sigma)[:, None] * noise,
        sigma,
        condition * per_example(kept)[:, None],
    )
    error, contact_error = (prediction[:, :2] - clean).unbind(1)
    weight = 1.0 + batch["contact"][:, 0]  # the residual counts twice in contact
    level_weight = per_example(((1.0 + sigma**2) / sigma**2).clamp(max=5.0))
    robust = functional.huber_loss(error, torch.zeros_like(error), delta=_HUBER, reduction="none")
    squared = 0.5 * error**2 * level_weight
    residual = torch.where(per_example(terminal), robust / _HUBER, squared) * weight
    terms = {
        "residual": (1.0, residual.mean()),
        "contact": (_CONTACT_TERM, (contact_error**2 * level_weight).mean()),
        "spread": (_UNCERTAINTY_TERM, _compute_laplace_loss(prediction, error)),
    }
    if slope_weight > 0.0:
        slopes = [error.diff(dim=axis).square().mean() for axis in (-1, -2)]
        terms["slopes"] = slope_weight, slopes[0] + slopes[1]
    return weigh_terms(terms)


def compute_uncertainty_loss(
    network: nn.Module, batch: Mapping[str, Tensor]
) -> tuple[Tensor, dict[str, Any]]:
    """Negative log-likelihood of one step's errors under the predicted uncertainty.

    For recipes whose `rate_factors` freeze all other parameters. A network is right about touches
    it was trained on; only other touches show how large its errors are.
    """
    import torch

    net = unwrap_network(network)
    net.eval()  # normalisation statistics stay
    clean = batch["residual"]
    sigma = torch.full((len(clean),), float(net.sigma_max), device=clean.device)
    prediction = network(torch.zeros_like(clean), sigma, batch["condition"][:, : net.inputs])
    spread = _compute_laplace_loss(prediction, prediction[:, 0] - clean[:, 0])
    return weigh_terms({"spread": (1.0, spread)})


def _compute_laplace_loss(prediction: Tensor, error: Tensor) -> Tensor:
    """Negative log-likelihood of errors (n, rows, cols), Laplace.

    Channel 2 predicts the log of their mean.
    """
    log = prediction[:, 2].clamp(*LOG_ERROR_RANGE)
    return (error.detach().abs() * (-log).exp() + log).mean()
