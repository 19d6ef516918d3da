"""The training loop: the same steps for the same recipe, however often it is stopped and
resumed.
"""

from __future__ import annotations

import copy
import logging
import math
import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.errors import FileProblem, NotConverged
from pipeline.core.files import check_folder
from pipeline.core.progress import SILENT, Cancelled, Progress
from pipeline.lab.training import curves, optimising, state
from pipeline.lab.training.cached_examples import iterate_cached_batches, to_channels_last
from pipeline.lab.training.distributed import ProcessGroup, join_process_group, wrap_precision
from pipeline.lab.training.examples import ExampleSource, open_example_source
from pipeline.lab.training.recipe import Recipe, load_initial_weights
from pipeline.lab.training.recorded_pairs import use_pairs
from pipeline.lab.training.state import TrainingState
from pipeline.lab.training.task import HasNotes, Task
from pipeline.stages.networks.network_factory import (
    build_network,
    initialise_from,
    use_channels_last,
)

if TYPE_CHECKING:
    from torch import Tensor

    from pipeline.lab.training.task import Example, Split

SAVE_INTERVAL_S = 60.0
LOG_INTERVAL_STEPS = 25
MAX_SKIPPED_STEPS = 10  # in a row, before training ends with an error
log = logging.getLogger("tactoscope")


@dataclass(frozen=True, slots=True, kw_only=True)
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
    if not state.has_state(run.folder):
        now = TrainingState(recipe=state.serialise_recipe(run.recipe), command=run.command)
    elif run.resume:
        now = state.load_for_resume(run.folder, run.recipe)
    else:
        raise FileProblem(
            "this folder holds a training run; give --resume to continue it, or another --out",
            run.folder,
        )
    check_folder(run.folder)
    settings = run.recipe.training
    task = use_pairs(run.recipe.settings, run.recipe.pairs)
    for note in task.collect_notes() if isinstance(task, HasNotes) else ():
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
        self._recipe = run.recipe
        self._task = task
        torch.manual_seed(self._recipe.training.seed)
        arguments = {key: value for key, value in self._recipe.network.items() if key != "kind"}
        network = build_network(str(self._recipe.network["kind"]), arguments)
        self._network = use_channels_last(network).to(group.device)
        if not now.step:
            self._load_initial_weights()
        self._average = optimising.copy_for_averaging(self._network)
        self._optimiser = optimising.make_optimiser(
            self._network, self._recipe.optimiser, self._recipe.rate_factors
        )
        if now.step:
            self._network.load_state_dict(now.network_tensors)
            self._average.load_state_dict(now.averaged_tensors)
            self._optimiser.load_state_dict(now.optimiser_state)
        self._wrapped = group.wrap_distributed(
            wrap_precision(self._network, self._recipe.training.precision, group.device)
        )
        self._held_out: dict[Split, list[Example]] = {}
        if group.device.type == "cuda":
            now.device = torch.cuda.get_device_name(group.device)
        if group.world_size == 1:  # several processes stop together, after a step
            source.check = self._check_stop
        self._start_s = time.monotonic() - now.trained_s
        self._saved_s = time.monotonic()

    def _load_initial_weights(self) -> None:
        file = self._recipe.training.initial_weights
        if file:
            weights = load_initial_weights(file, str(self._recipe.network["kind"]))
            n = initialise_from(self._network, weights)
            log.warning(
                "%d tensors start from %s, %d are random",
                n,
                file,
                len(self._network.state_dict()) - n,
            )

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
        stride = self._recipe.training.batch * group.world_size
        fraction = group.average_over_processes(self._compute_fraction())[0]
        with closing(self._batches(stride)) as batches:
            while not self._is_over(fraction):
                stop = self._find_stop(fraction)
                loss, terms = self._backpropagate(next(batches), fraction)
                mean_loss, any_stop, next_fraction = group.average_over_processes(
                    loss, float(stop is not None), self._compute_fraction(ahead=1)
                )
                now.step, now.n_examples = now.step + 1, now.n_examples + stride
                self._update_weights(mean_loss, terms)
                before = fraction
                fraction = next_fraction
                times = self._recipe.validation.n_evaluations
                if math.floor(min(fraction, 1.0) * times) > math.floor(min(before, 1.0) * times):
                    self._validate()
                if any_stop:
                    raise stop or Cancelled
                if time.monotonic() > self._saved_s + SAVE_INTERVAL_S:
                    self._warn_if_full(self._save)

    def _batches(self, stride: int) -> Generator[dict[str, Tensor], None, None]:
        """Batches on the device, from this step on.

        Making cached examples does not count as training time.
        """
        now = self._now
        group = self._group
        settings = self._recipe.training
        if settings.n_cached_examples:
            cached = iterate_cached_batches(self._source, settings, group, now.step)
            begin_s = time.monotonic()
            try:
                batch = next(cached)
            finally:
                self._start_s += time.monotonic() - begin_s
            yield batch
            yield from cached
            return
        first = now.step * stride + group.rank * settings.batch
        with closing(self._source.iterate_batches(first, stride)) as batches:
            for batch in batches:
                yield to_tensors(batch, group.device)

    def _is_over(self, fraction: float) -> bool:
        return (
            fraction >= 1.0
            if self._run.max_minutes is not None
            else self._now.step >= self._recipe.training.steps
        )

    def _compute_fraction(self, ahead: int = 0) -> float:
        """Share of the run that is done after `ahead` more steps."""
        if self._run.max_minutes is not None:
            return (time.monotonic() - self._start_s) / (60.0 * self._run.max_minutes)
        return (self._now.step + ahead) / self._recipe.training.steps

    def _check_stop(self) -> None:
        """Raise the request to stop, if there is one, while examples are made."""
        stop = self._find_stop(self._compute_fraction())
        if stop is not None:
            raise stop

    def _find_stop(self, fraction: float) -> BaseException | None:
        """Report progress; the request to stop, if there is one."""
        loss = self._now.curve[-1]["loss"] if self._now.curve else math.nan
        status = f"step {self._now.step:,}, {self._now.n_examples:,} examples"
        try:
            self._progress.step(
                min(fraction, 1.0), status if math.isnan(loss) else f"{status}, loss {loss:.4g}"
            )
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

        now = self._now
        seed = self._recipe.training.seed
        # of dropout and noise in the loss
        seeds = np.random.SeedSequence([seed, now.step, self._group.rank])
        torch.manual_seed(int(seeds.generate_state(1)[0]))
        rate = optimising.compute_learning_rate(self._recipe.optimiser, now.step, fraction)
        optimising.set_learning_rate(self._optimiser, rate)
        self._wrapped.train()
        self._optimiser.zero_grad()
        loss, terms = self._task.compute_loss(self._wrapped, batch)
        loss.backward()
        return float(loss.detach()), {**terms, "learning rate": rate}

    def _update_weights(self, loss: float, terms: dict[str, Any]) -> None:
        """Step the optimiser if loss and gradient are finite.

        Raises NotConverged after many skipped steps.
        """
        import torch

        now = self._now
        recipe = self._recipe.optimiser
        norm = float(
            torch.nn.utils.clip_grad_norm_(self._network.parameters(), recipe.max_gradient_norm)
        )
        if not (math.isfinite(loss) and math.isfinite(norm)):
            now.n_skipped, now.n_skipped_in_a_row = now.n_skipped + 1, now.n_skipped_in_a_row + 1
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
        optimising.update_average(self._average, self._network, recipe.ema_decay, now.step - 1)
        for name, value in {"loss": loss, "gradient": norm, **terms}.items():
            now.sums[name] = now.sums.get(name, 0.0) + float(value)
        now.n_summed += 1
        if now.step % LOG_INTERVAL_STEPS == 0:
            seconds = {"minutes": (time.monotonic() - self._start_s) / 60.0}
            means = {name: total / now.n_summed for name, total in now.sums.items()}
            now.curve.append({"step": now.step, "examples": now.n_examples, **seconds, **means})
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
        with torch.inference_mode():
            for split, held_out in self._held_out.items():
                for name, value in self._task.evaluate(network, held_out).items():
                    now.metrics.append(
                        {"step": now.step, "split": split, "name": name, "value": float(value)}
                    )
        texts = [
            f"{row['split'].replace('_', ' ')} {row['name']} {row['value']:.4g}"
            for row in now.metrics
            if row["step"] == now.step
        ]
        log.info("step %d: %s", now.step, "; ".join(texts))
        now.trained_s = time.monotonic() - self._start_s
        self._warn_if_full(lambda: curves.draw_curves(self._run.folder, now))

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
        state.save_state(self._run.folder, now)
        curves.write_tables(self._run.folder, now)


def to_tensors(batch: Example, device: Any) -> dict[str, Any]:
    """A batch of arrays as tensors on a device."""
    import torch

    return {
        name: to_channels_last(torch.from_numpy(array).to(device)) for name, array in batch.items()
    }
