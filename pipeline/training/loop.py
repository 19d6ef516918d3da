"""The loop of all training: the same steps for the same recipe, however often it is stopped and gone on with."""

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

from pipeline.base.errors import FileProblem, NotConverged
from pipeline.base.files import prepare_folder
from pipeline.base.progress import SILENT, Cancelled, Progress
from pipeline.networks import weights_registry
from pipeline.networks.network_factory import build_network, initialise_from, use_channels_last
from pipeline.training import curves, optimising, state
from pipeline.training.cached_examples import iterate_cached_batches
from pipeline.training.distributed import ProcessGroup, join_process_group, wrap_precision
from pipeline.training.examples import ExampleSource, open_example_source
from pipeline.training.recipe import Recipe
from pipeline.training.recorded_touches import mix_recordings
from pipeline.training.state import TrainingState
from pipeline.training.task import HasNotes

if TYPE_CHECKING:
    from torch import Tensor

    from pipeline.training.task import Example, Split

SAVE_INTERVAL_S = 60.0
LOG_INTERVAL_STEPS = 25  # steps
MAX_SKIPPED_STEPS = 10  # in a row: what is wrong then does not pass
log = logging.getLogger("tactoscope")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingRun:
    """A training run as a user asks for it."""

    recipe: Recipe
    folder: Path
    resume: bool = False
    max_minutes: float | None = None  # trained in all, stops included or not; None = as many steps as the recipe says
    n_workers: int = 1
    command: str = ""


def train(run: TrainingRun, progress: Progress = SILENT) -> TrainingState:
    """Train to the end and leave state and curves in the run's folder; returns the last state.

    When `progress` cancels, everything so far is kept and the error goes on; with `resume` the next call goes on at the
    very step, and ends with the same weights as if it had not been stopped. By minutes it is the rate of learning that
    follows the clock, so that the same seed gives the same examples but not the same weights.
    Raises FileProblem, SettingProblem, and NotConverged where the loss is no number any more.
    """
    begun = state.has_state(run.folder)
    if begun and not run.resume:
        raise FileProblem("a training was begun here and is kept; give --resume to go on, or another --out", run.folder)
    now = (
        state.load_for_resume(run.folder, run.recipe)
        if begun
        else TrainingState(recipe=state.serialise_recipe(run.recipe), command=run.command)
    )
    prepare_folder(run.folder)
    pace = run.recipe.training
    task = mix_recordings(run.recipe.settings, run.recipe.recordings, run.recipe.recorded_share)
    for note in task.collect_notes() if isinstance(task, HasNotes) else ():
        log.warning("%s", note)
    with join_process_group() as here, open_example_source(task, pace.seed, pace.batch, run.n_workers) as source:
        return _Training(run, now, here, source, progress).run()


class _Training:
    """What a run holds while it goes: networks, optimiser, clock."""

    def __init__(
        self, run: TrainingRun, now: TrainingState, here: ProcessGroup, source: ExampleSource, progress: Progress
    ) -> None:
        import torch

        self._run, self._now, self._here, self._source, self._progress = run, now, here, source, progress
        self._recipe, self._task = run.recipe, run.recipe.settings
        torch.manual_seed(self._recipe.training.seed)
        self._network = use_channels_last(
            build_network(str(self._recipe.network["kind"]), _arguments(self._recipe))
        ).to(here.device)
        if not now.step:
            self._begin()
        self._average = optimising.copy_for_averaging(self._network)
        self._optimiser = optimising.make_optimiser(self._network, self._recipe.optimiser, self._recipe.rate_factors)
        if now.step:
            self._network.load_state_dict(now.network_tensors)
            self._average.load_state_dict(now.averaged_tensors)
            self._optimiser.load_state_dict(now.optimiser_state)
        self._learns = here.wrap_distributed(
            wrap_precision(self._network, self._recipe.training.precision, here.device)
        )
        self._held_out: dict[Split, list[Example]] = {}
        if here.device.type == "cuda":
            now.device = torch.cuda.get_device_name(here.device)
        self._since_s = time.monotonic() - now.trained_s
        self._saved_s = time.monotonic()

    def _begin(self) -> None:
        """Where the recipe says so, begin with learned weights rather than with random ones."""
        file = self._recipe.training.initial_weights
        if file:
            weights = weights_registry.select_reader(str(self._recipe.network["kind"]))(Path(file))
            n = initialise_from(self._network, weights)
            log.warning("begun with %d tensors of %s, %d are new", n, file, len(self._network.state_dict()) - n)

    def run(self) -> TrainingState:
        """Step by step to the end, or until somebody asks to stop; what asked is raised once all is kept."""
        now, here, pace = self._now, self._here, self._recipe.training
        stride = pace.batch * here.world_size
        fraction = here.average_over_processes(self._fraction())[0]
        with closing(self._batches(stride)) as batches:
            while not self._is_over(fraction):
                stop = self._asked(fraction)
                loss, parts = self._learn(next(batches), fraction)
                agreed = here.average_over_processes(loss, float(stop is not None), self._fraction(ahead=1))
                now.step, now.n_examples = now.step + 1, now.n_examples + stride
                self._change(agreed[0], parts)
                before, fraction = fraction, agreed[2]
                times = self._recipe.validation.n_evaluations
                if math.floor(min(fraction, 1.0) * times) > math.floor(min(before, 1.0) * times):
                    self._validate()
                if agreed[1]:
                    self._keep()
                    raise stop or Cancelled
                if time.monotonic() > self._saved_s + SAVE_INTERVAL_S:
                    self._unless_full(self._keep)
        self._keep()
        return now

    def _batches(self, stride: int) -> Generator[dict[str, Tensor], None, None]:
        """Batches on the device from here on; the clock of a run stands still while those that are kept are made."""
        now, here, pace = self._now, self._here, self._recipe.training
        if pace.n_cached_examples:
            began_s = time.monotonic()
            for batch in iterate_cached_batches(self._source, pace, here, now.step):
                if began_s is not None:
                    self._since_s, began_s = self._since_s + time.monotonic() - began_s, None
                yield batch
            return
        with closing(self._source.iterate_batches(now.step * stride + here.rank * pace.batch, stride)) as batches:
            for batch in batches:
                yield to_tensors(batch, here.device)

    def _is_over(self, fraction: float) -> bool:
        return fraction >= 1.0 if self._run.max_minutes is not None else self._now.step >= self._recipe.training.steps

    def _fraction(self, ahead: int = 0) -> float:
        """How much of the run is over once `ahead` more steps are."""
        if self._run.max_minutes is not None:
            return (time.monotonic() - self._since_s) / (60.0 * self._run.max_minutes)
        return (self._now.step + ahead) / self._recipe.training.steps

    def _asked(self, fraction: float) -> BaseException | None:
        """What asks to stop, if anything does."""
        loss = self._now.curve[-1]["loss"] if self._now.curve else math.nan
        told = f"step {self._now.step:,}, {self._now.n_examples:,} examples"
        try:
            self._progress.step(min(fraction, 1.0), told if math.isnan(loss) else f"{told}, loss {loss:.4g}")
        except (Cancelled, KeyboardInterrupt) as stop:
            return stop
        return None

    def _learn(self, batch: dict[str, Tensor], fraction: float) -> tuple[float, dict[str, Any]]:
        """The loss of a batch and its parts; its gradient is in the network, the mean over all devices."""
        import torch

        now, pace = self._now, self._recipe.training
        seeds = np.random.SeedSequence([pace.seed, now.step, self._here.rank])  # of dropout and the like
        torch.manual_seed(int(seeds.generate_state(1)[0]))
        rate = optimising.compute_learning_rate(self._recipe.optimiser, now.step, fraction)
        optimising.set_learning_rate(self._optimiser, rate)
        self._learns.train()
        self._optimiser.zero_grad()
        loss, parts = self._task.compute_loss(self._learns, batch)
        loss.backward()
        return float(loss.detach()), {**parts, "learning rate": rate}

    def _change(self, loss: float, parts: dict[str, Any]) -> None:
        """Follow the gradient where it is a number; raises NotConverged where it has not been one for long."""
        import torch

        now, recipe = self._now, self._recipe.optimiser
        norm = float(torch.nn.utils.clip_grad_norm_(self._network.parameters(), recipe.max_gradient_norm))
        if not (math.isfinite(loss) and math.isfinite(norm)):
            now.n_skipped, now.n_skipped_in_a_row = now.n_skipped + 1, now.n_skipped_in_a_row + 1
            log.warning("step %d is left out: its loss is %g, its gradient %g long", now.step, loss, norm)
            if now.n_skipped_in_a_row >= MAX_SKIPPED_STEPS:
                self._keep()
                raise NotConverged(
                    f"the loss has been no number for {MAX_SKIPPED_STEPS} steps up to {now.step}; try a lower learning_rate "
                    f"or max_gradient_norm in the recipe (the last good state is kept in {str(self._run.folder)!r})"
                )
            return
        now.n_skipped_in_a_row = 0
        self._optimiser.step()
        optimising.update_average(self._average, self._network, recipe.ema_decay, now.step - 1)
        for name, value in {"loss": loss, "gradient": norm, **parts}.items():
            now.sums[name] = now.sums.get(name, 0.0) + float(value)
        now.n_summed += 1
        if now.step % LOG_INTERVAL_STEPS == 0:
            seconds = {"minutes": (time.monotonic() - self._since_s) / 60.0}
            means = {name: total / now.n_summed for name, total in now.sums.items()}
            now.curve.append({"step": now.step, "examples": now.n_examples, **seconds, **means})
            now.sums, now.n_summed = {}, 0

    def _validate(self) -> None:
        """Add the figures of the averaged weights on what was held out, and draw; the first device does."""
        import torch

        now = self._now
        if self._here.rank:
            return
        self._held_out = self._held_out or self._source.make_validation_set(self._recipe.validation.n_examples)
        judged = copy.deepcopy(self._average).cpu()
        with torch.inference_mode():
            for split, held_out in self._held_out.items():
                for name, value in self._task.evaluate(judged, held_out).items():
                    now.metrics.append({"step": now.step, "split": split, "name": name, "value": float(value)})
        found = [f"{row['split'].replace('_', ' ')} {row['name']} {row['value']:.4g}" for row in now.metrics
                 if row["step"] == now.step]  # fmt: skip
        log.info("step %d: %s", now.step, "; ".join(found))
        now.trained_s = time.monotonic() - self._since_s
        self._unless_full(lambda: curves.draw_curves(self._run.folder, now))

    @staticmethod
    def _unless_full(write: Callable[[], None]) -> None:
        """Write what can be written later as well: a disk that is full now ends no training of hours, it is said."""
        try:
            write()
        except FileProblem as problem:
            log.warning("%s; the training goes on, and will try again", problem)

    def _keep(self) -> None:
        """Bring all to the disk; the first device does."""
        now = self._now
        self._saved_s = time.monotonic()
        now.trained_s = self._saved_s - self._since_s
        if self._here.rank:
            return
        now.network_tensors, now.averaged_tensors = self._network.state_dict(), self._average.state_dict()
        now.optimiser_state = self._optimiser.state_dict()
        state.save_state(self._run.folder, now)
        curves.write_tables(self._run.folder, now)


def to_tensors(batch: Example, device: Any) -> dict[str, Any]:
    """A batch of arrays as tensors on a device, pictures with their channels innermost."""
    import torch

    made: dict[str, Any] = {}
    for name, array in batch.items():
        tensor = torch.from_numpy(array).to(device)
        made[name] = tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor
    return made


def _arguments(recipe: Recipe) -> dict[str, Any]:
    return {key: value for key, value in recipe.network.items() if key != "kind"}
