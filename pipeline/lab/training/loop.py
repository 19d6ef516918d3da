"""The training loop: the same steps for the same recipe, however often it is stopped and
resumed.
"""

from __future__ import annotations

import copy
import logging
import math
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.errors import FileProblem, NotConverged
from pipeline.core.files import check_folder
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Cancelled, Progress
from pipeline.lab.training import run_folder
from pipeline.lab.training.distributed import ProcessGroup, join_process_group, wrap_precision
from pipeline.lab.training.examples import (
    ExampleSource,
    iterate_cached_batches,
    open_example_source,
    to_tensors,
)
from pipeline.lab.training.recipe import Optimiser, Recipe, load_initial_weights
from pipeline.lab.training.recorded_pairs import use_pairs
from pipeline.lab.training.run_folder import TrainingState
from pipeline.lab.training.task import Task
from pipeline.stages.networks.network_factory import (
    build_network,
    initialise_from,
    use_channels_last,
)

if TYPE_CHECKING:
    from torch import Tensor, nn, optim

    from pipeline.lab.training.task import Example, Split

_POWER = 0.9  # of the schedule "poly", as depth networks on DINOv2 are trained
SAVE_INTERVAL_S = 60.0
LOG_INTERVAL_STEPS = 25
MAX_SKIPPED_STEPS = 10  # in a row, before training ends with an error
log = logging.getLogger("tactoscope")


@frozen
class TrainingRun:
    """Options of one training run."""

    recipe: Recipe
    folder: Path
    resume: bool = False
    # of training over all parts of the run; None = the steps of the recipe
    max_minutes: float | None = None
    n_workers: int = 1
    command: str = ""


def train(run: TrainingRun, progress: Progress = SILENT) -> TrainingState:
    """Train to the end, write state and curves into the run's folder, and return the last state.

    When `progress` cancels, the state is saved and the error passes on; with `resume` the next call
    continues at that step and ends with the same weights as an uninterrupted run. With
    `max_minutes` the learning rate follows the clock, so that the same seed gives the same examples
    but not the same weights. Raises FileProblem, SettingProblem, and NotConverged where the loss
    stays NaN or infinite.
    """
    if not run_folder.has_state(run.folder):
        now = TrainingState(recipe=run_folder.serialise_recipe(run.recipe), command=run.command)
    elif run.resume:
        now = run_folder.load_for_resume(run.folder, run.recipe)
    else:
        raise FileProblem(
            "this folder holds a training run; give --resume to continue it, or another --out",
            run.folder,
        )
    check_folder(run.folder)
    settings = run.recipe.training
    task = use_pairs(run.recipe.settings, run.recipe.pairs)
    for note in task.collect_notes():
        log.warning("%s", note)
    with (
        join_process_group() as group,
        open_example_source(task, settings.seed, settings.batch, run.n_workers) as source,
    ):
        return _Training(run, now, task, group, source, progress).run()


class _Training:
    """Networks, optimiser and clock of a run in progress."""

    def __init__(
        self,
        run: TrainingRun,
        now: TrainingState,
        task: Task,
        group: ProcessGroup,
        source: ExampleSource,
        progress: Progress,
    ) -> None:
        import torch

        self._run = run
        self._now = now
        self._group = group
        self._source = source
        self._progress = progress
        self._task = task
        self._recipe = recipe = run.recipe
        self._settings = recipe.training
        torch.manual_seed(self._settings.seed)
        arguments = dict(recipe.network)
        kind = str(arguments.pop("kind"))
        self._network = use_channels_last(build_network(kind, arguments)).to(group.device)
        if self._settings.initial_weights and not now.step:
            self._load_initial_weights(kind)
        self._average = copy_for_averaging(self._network)
        self._optimiser = make_optimiser(self._network, recipe.optimiser, recipe.rate_factors)
        if now.step:
            self._network.load_state_dict(now.network_tensors)
            self._average.load_state_dict(now.averaged_tensors)
            self._optimiser.load_state_dict(now.optimiser_state)
        self._wrapped = group.wrap_distributed(
            wrap_precision(self._network, self._settings.precision, group.device)
        )
        self._held_out: dict[Split, list[Example]] = {}
        if group.device.type == "cuda":
            now.device = torch.cuda.get_device_name(group.device)
        if group.world_size == 1:  # several processes stop together, after a step
            source.check = self._check_stop
        self._start_s = time.monotonic() - now.trained_s
        self._saved_s = time.monotonic()

    def _load_initial_weights(self, kind: str) -> None:
        file = self._settings.initial_weights
        n = initialise_from(self._network, load_initial_weights(file, kind))
        n_random = len(self._network.state_dict()) - n
        log.warning("%d tensors start from %s, %d are random", n, file, n_random)

    def run(self) -> TrainingState:
        """Train to the end or to a request to stop, which is raised once the state is saved."""
        try:
            self._run_steps()
        except (Cancelled, KeyboardInterrupt):
            self._save()
            raise
        self._save()
        return self._now

    def _run_steps(self) -> None:
        now = self._now
        group = self._group
        stride = self._settings.batch * group.world_size
        times = self._recipe.validation.n_evaluations
        fraction = group.average_over_processes(self._compute_fraction())[0]
        with closing(self._batches(stride)) as batches:
            while not self._is_over(fraction):
                stop = self._find_stop(fraction)
                loss, terms = self._backpropagate(next(batches), fraction)
                mean_loss, any_stop, next_fraction = group.average_over_processes(
                    loss, float(stop is not None), self._compute_fraction(ahead=1)
                )
                now.step += 1
                now.n_examples += stride
                self._update_weights(mean_loss, terms)
                if math.floor(min(next_fraction, 1.0) * times) > math.floor(fraction * times):
                    self._validate()
                fraction = min(next_fraction, 1.0)
                if any_stop:
                    raise stop or Cancelled
                if time.monotonic() > self._saved_s + SAVE_INTERVAL_S:
                    self._warn_if_full(self._save)

    def _batches(self, stride: int) -> Generator[dict[str, Tensor], None, None]:
        """Batches on the device, from this step on.

        Making cached examples does not count as training time.
        """
        if self._settings.n_cached_examples:
            cached = iterate_cached_batches(
                self._source, self._settings, self._group, self._now.step
            )
            begin_s = time.monotonic()
            try:
                batch = next(cached)
            finally:
                self._start_s += time.monotonic() - begin_s
            yield batch
            yield from cached
            return
        first = self._now.step * stride + self._group.rank * self._settings.batch
        with closing(self._source.iterate_batches(first, stride)) as batches:
            for made in batches:
                yield to_tensors(made, self._group.device)

    def _is_over(self, fraction: float) -> bool:
        if self._run.max_minutes is None:
            return self._now.step >= self._settings.steps
        return fraction >= 1.0

    def _compute_fraction(self, ahead: int = 0) -> float:
        """Share of the run that is done after `ahead` more steps."""
        if self._run.max_minutes is None:
            return (self._now.step + ahead) / self._settings.steps
        return (time.monotonic() - self._start_s) / (60.0 * self._run.max_minutes)

    def _check_stop(self) -> None:
        """Raise the request to stop, if there is one, while examples are made."""
        stop = self._find_stop(self._compute_fraction())
        if stop is not None:
            raise stop

    def _find_stop(self, fraction: float) -> BaseException | None:
        """Report progress; the request to stop, if there is one."""
        status = f"step {self._now.step:,}, {self._now.n_examples:,} examples"
        if self._now.curve:
            status += f", loss {self._now.curve[-1]['loss']:.4g}"
        try:
            self._progress.step(min(fraction, 1.0), status)
        except (Cancelled, KeyboardInterrupt) as stop:
            return stop
        return None

    def _backpropagate(
        self, batch: dict[str, Tensor], fraction: float
    ) -> tuple[float, dict[str, Any]]:
        """Loss of a batch and its terms.

        Leaves the gradient, averaged over all processes, in the network.
        """
        import torch

        # of dropout and noise in the loss
        seeds = np.random.SeedSequence([self._settings.seed, self._now.step, self._group.rank])
        torch.manual_seed(int(seeds.generate_state(1)[0]))
        rate = compute_learning_rate(self._recipe.optimiser, self._now.step, fraction)
        set_learning_rate(self._optimiser, rate)
        self._wrapped.train()
        self._optimiser.zero_grad()
        loss, terms = self._task.compute_loss(self._wrapped, batch)
        loss.backward()
        return float(loss.detach()), {**terms, "learning rate": rate}

    def _update_weights(self, loss: float, terms: dict[str, Any]) -> None:
        """Step the optimiser if loss and gradient are finite.

        Raises NotConverged after many skipped steps.
        """
        from torch.nn.utils import clip_grad_norm_

        now = self._now
        recipe = self._recipe.optimiser
        norm = float(clip_grad_norm_(self._network.parameters(), recipe.max_gradient_norm))
        if not (math.isfinite(loss) and math.isfinite(norm)):
            now.n_skipped += 1
            now.n_skipped_in_a_row += 1
            log.warning("step %d is skipped: loss %g, gradient norm %g", now.step, loss, norm)
            if now.n_skipped_in_a_row >= MAX_SKIPPED_STEPS:
                self._save()
                raise NotConverged(
                    f"loss or gradient was not finite for {MAX_SKIPPED_STEPS} steps up to step "
                    f"{now.step}; lower "
                    "learning_rate or max_gradient_norm in the recipe (the last state is in "
                    f"{str(self._run.folder)!r})"
                )
            return
        now.n_skipped_in_a_row = 0
        self._optimiser.step()
        update_average(self._average, self._network, recipe.ema_decay, now.step - 1)
        for name, value in {"loss": loss, "gradient": norm, **terms}.items():
            now.sums[name] = now.sums.get(name, 0.0) + float(value)
        now.n_summed += 1
        if now.step % LOG_INTERVAL_STEPS == 0:
            minutes = (time.monotonic() - self._start_s) / 60.0
            means = {name: total / now.n_summed for name, total in now.sums.items()}
            now.curve.append(
                {"step": now.step, "examples": now.n_examples, "minutes": minutes, **means}
            )
            now.sums = {}
            now.n_summed = 0

    def _validate(self) -> None:
        """Add the metrics of the averaged weights on the validation examples and draw the curves.

        In process 0.
        """
        import torch

        now = self._now
        if self._group.rank:
            return
        self._held_out = self._held_out or self._source.make_validation_set(
            self._recipe.validation.n_examples
        )
        network = copy.deepcopy(self._average).cpu()
        for split, held_out in self._held_out.items():
            with torch.inference_mode():
                metrics = self._task.evaluate(network, held_out)
            now.metrics += [
                {"step": now.step, "split": split, "name": name, "value": float(value)}
                for name, value in metrics.items()
            ]
        texts = [f"{name} {value:.4g}" for name, value in now.list_last_metrics().items()]
        log.info("step %d: %s", now.step, "; ".join(texts))
        now.trained_s = time.monotonic() - self._start_s
        self._warn_if_full(lambda: run_folder.draw_curves(self._run.folder, now))

    @staticmethod
    def _warn_if_full(write: Callable[[], None]) -> None:
        """Write what can be written later as well.

        A full disk is a warning and does not end the training.
        """
        try:
            write()
        except FileProblem as problem:
            log.warning("%s; training continues and tries again", problem)

    def _save(self) -> None:
        """Write state and curves; in process 0."""
        now = self._now
        self._saved_s = time.monotonic()
        now.trained_s = self._saved_s - self._start_s
        if self._group.rank:
            return
        now.network_tensors = self._network.state_dict()
        now.averaged_tensors = self._average.state_dict()
        now.optimiser_state = self._optimiser.state_dict()
        run_folder.save_state(self._run.folder, now)
        run_folder.write_tables(self._run.folder, now)


def make_optimiser(
    network: nn.Module, recipe: Optimiser, factors: Mapping[str, float]
) -> optim.Optimizer:
    """An optimiser with one parameter group for each factor of the learning rate.

    `factors` maps prefixes of parameter names to factors; the longest matching prefix applies, 1
    without one.
    """
    from torch import optim

    shares: dict[float, list[Any]] = {}
    for name, parameter in network.named_parameters():
        prefixes = [prefix for prefix in factors if name.startswith(prefix)]
        shares.setdefault(factors[max(prefixes, key=len)] if prefixes else 1.0, []).append(
            parameter
        )
    groups = [{"params": parameters, "share": share} for share, parameters in shares.items()]
    kind = optim.AdamW if recipe.kind == "adamw" else optim.Adam
    return kind(
        groups, lr=recipe.learning_rate, betas=(0.9, recipe.beta2), weight_decay=recipe.weight_decay
    )


def set_learning_rate(made: optim.Optimizer, rate: float) -> None:
    """Set the learning rate of every group."""
    for group in made.param_groups:
        group["lr"] = rate * group["share"]


def compute_learning_rate(recipe: Optimiser, step: int, fraction: float) -> float:
    """The learning rate of a step, where `fraction` (0..1) of the run is done."""
    left = 1.0 - min(max(fraction, 0.0), 1.0)
    falling = {
        "cosine": 0.5 * (1.0 - math.cos(math.pi * left)),
        "poly": left**_POWER,
        "constant": 1.0,
    }
    share = recipe.final_share + (1.0 - recipe.final_share) * falling[recipe.schedule]
    return recipe.learning_rate * share * min(1.0, (step + 1) / max(recipe.warm_up_steps, 1))


def copy_for_averaging(network: nn.Module) -> nn.Module:
    """A copy of the network that holds the moving average."""
    return copy.deepcopy(network).eval().requires_grad_(requires_grad=False)


def update_average(mean: nn.Module, network: nn.Module, decay: float, step: int) -> None:
    """Move the average towards the network, faster in the first steps, whose weights are far
    off.
    """
    import torch

    share = 1.0 - min(decay, (1.0 + step) / (10.0 + step))
    with torch.no_grad():
        for average, new in zip(
            mean.state_dict().values(), network.state_dict().values(), strict=True
        ):
            if average.is_floating_point():
                average.lerp_(new, share)
            else:
                average.copy_(new)
