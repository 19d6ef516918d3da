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
from pipeline.base.files import ready
from pipeline.base.progress import SILENT, Cancelled, Progress
from pipeline.networks import shelf
from pipeline.networks.building import begin_with, build, innermost
from pipeline.training import curves, optimising, state
from pipeline.training.devices import Devices, devices, in_precision
from pipeline.training.examples import Examples, examples
from pipeline.training.kept_examples import kept
from pipeline.training.own import mixed
from pipeline.training.recipe import Recipe
from pipeline.training.state import State
from pipeline.training.task import Noted

if TYPE_CHECKING:
    from torch import Tensor

    from pipeline.training.task import Example, Split

SAVED_EVERY_S = 60.0
LINE_EVERY = 25  # steps
MOST_SKIPPED = 10  # in a row: what is wrong then does not pass
log = logging.getLogger("tactoscope")


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A training run as a user asks for it."""

    recipe: Recipe
    out: Path
    resume: bool = False
    minutes: float | None = None  # trained in all, stops included or not; None = as many steps as the recipe says
    workers: int = 1
    command: str = ""


def train(run: Run, progress: Progress = SILENT) -> State:
    """Train to the end and leave state and curves in the run's folder; returns the last state.

    When `progress` cancels, everything so far is kept and the error goes on; with `resume` the next call goes on at the
    very step, and ends with the same weights as if it had not been stopped. By minutes it is the rate of learning that
    follows the clock, so that the same seed gives the same examples but not the same weights.
    Raises FileProblem, SettingProblem, and NotConverged where the loss is no number any more.
    """
    begun = state.is_there(run.out)
    if begun and not run.resume:
        raise FileProblem("a training was begun here and is kept; give --resume to go on, or another --out", run.out)
    now = state.to_go_on(run.out, run.recipe) if begun else State(recipe=state.words(run.recipe), command=run.command)
    ready(run.out)
    pace = run.recipe.pace
    task = mixed(run.recipe.settings, run.recipe.recordings, run.recipe.share)
    for note in task.notes() if isinstance(task, Noted) else ():
        log.warning("%s", note)
    with devices() as here, examples(task, pace.seed, pace.batch, run.workers) as source:
        return _Training(run, now, here, source, progress).run()


class _Training:
    """What a run holds while it goes: networks, optimiser, clock."""

    def __init__(self, run: Run, now: State, here: Devices, source: Examples, progress: Progress) -> None:
        import torch

        self._run, self._now, self._here, self._source, self._progress = run, now, here, source, progress
        self._recipe, self._task = run.recipe, run.recipe.settings
        torch.manual_seed(self._recipe.pace.seed)
        self._network = innermost(build(str(self._recipe.network["kind"]), _arguments(self._recipe))).to(here.device)
        if not now.step:
            self._begin()
        self._average = optimising.averaged(self._network)
        self._optimiser = optimising.optimiser(self._network, self._recipe.optimiser, self._recipe.factors)
        if now.step:
            self._network.load_state_dict(now.network)
            self._average.load_state_dict(now.average)
            self._optimiser.load_state_dict(now.optimiser)
        self._learns = here.joined(in_precision(self._network, self._recipe.pace.precision, here.device))
        self._held_out: dict[Split, list[Example]] = {}
        if here.device.type == "cuda":
            now.device = torch.cuda.get_device_name(here.device)
        self._since_s = time.monotonic() - now.seconds
        self._saved_s = time.monotonic()

    def _begin(self) -> None:
        """Where the recipe says so, begin with learned weights rather than with random ones."""
        file = self._recipe.pace.begin
        if file:
            weights = shelf.reader(str(self._recipe.network["kind"]))(Path(file))
            n = begin_with(self._network, weights)
            log.warning("begun with %d tensors of %s, %d are new", n, file, len(self._network.state_dict()) - n)

    def run(self) -> State:
        """Step by step to the end, or until somebody asks to stop; what asked is raised once all is kept."""
        now, here, pace = self._now, self._here, self._recipe.pace
        stride = pace.batch * here.n
        fraction = here.mean(self._fraction())[0]
        with closing(self._batches(stride)) as batches:
            while not self._is_over(fraction):
                stop = self._asked(fraction)
                loss, parts = self._learn(next(batches), fraction)
                agreed = here.mean(loss, float(stop is not None), self._fraction(ahead=1))
                now.step, now.examples = now.step + 1, now.examples + stride
                self._change(agreed[0], parts)
                before, fraction = fraction, agreed[2]
                times = self._recipe.validation.times
                if math.floor(min(fraction, 1.0) * times) > math.floor(min(before, 1.0) * times):
                    self._validate()
                if agreed[1]:
                    self._keep()
                    raise stop or Cancelled
                if time.monotonic() > self._saved_s + SAVED_EVERY_S:
                    self._unless_full(self._keep)
        self._keep()
        return now

    def _batches(self, stride: int) -> Generator[dict[str, Tensor], None, None]:
        """Batches on the device from here on; the clock of a run stands still while those that are kept are made."""
        now, here, pace = self._now, self._here, self._recipe.pace
        if pace.kept:
            began_s = time.monotonic()
            for batch in kept(self._source, pace, here, now.step):
                if began_s is not None:
                    self._since_s, began_s = self._since_s + time.monotonic() - began_s, None
                yield batch
            return
        with closing(self._source.batches(now.step * stride + here.rank * pace.batch, stride)) as batches:
            for batch in batches:
                yield tensors(batch, here.device)

    def _is_over(self, fraction: float) -> bool:
        return fraction >= 1.0 if self._run.minutes is not None else self._now.step >= self._recipe.pace.steps

    def _fraction(self, ahead: int = 0) -> float:
        """How much of the run is over once `ahead` more steps are."""
        if self._run.minutes is not None:
            return (time.monotonic() - self._since_s) / (60.0 * self._run.minutes)
        return (self._now.step + ahead) / self._recipe.pace.steps

    def _asked(self, fraction: float) -> BaseException | None:
        """What asks to stop, if anything does."""
        loss = self._now.curve[-1]["loss"] if self._now.curve else math.nan
        told = f"step {self._now.step:,}, {self._now.examples:,} examples"
        try:
            self._progress.step(min(fraction, 1.0), told if math.isnan(loss) else f"{told}, loss {loss:.4g}")
        except (Cancelled, KeyboardInterrupt) as stop:
            return stop
        return None

    def _learn(self, batch: dict[str, Tensor], fraction: float) -> tuple[float, dict[str, Any]]:
        """The loss of a batch and its parts; its gradient is in the network, the mean over all devices."""
        import torch

        now, pace = self._now, self._recipe.pace
        seeds = np.random.SeedSequence([pace.seed, now.step, self._here.rank])  # of dropout and the like
        torch.manual_seed(int(seeds.generate_state(1)[0]))
        rate = optimising.learning_rate(self._recipe.optimiser, now.step, fraction)
        optimising.set_rate(self._optimiser, rate)
        self._learns.train()
        self._optimiser.zero_grad()
        loss, parts = self._task.loss(self._learns, batch)
        loss.backward()
        return float(loss.detach()), {**parts, "learning rate": rate}

    def _change(self, loss: float, parts: dict[str, Any]) -> None:
        """Follow the gradient where it is a number; raises NotConverged where it has not been one for long."""
        import torch

        now, recipe = self._now, self._recipe.optimiser
        norm = float(torch.nn.utils.clip_grad_norm_(self._network.parameters(), recipe.clip))
        if not (math.isfinite(loss) and math.isfinite(norm)):
            now.skipped, now.skipped_in_a_row = now.skipped + 1, now.skipped_in_a_row + 1
            log.warning("step %d is left out: its loss is %g, its gradient %g long", now.step, loss, norm)
            if now.skipped_in_a_row >= MOST_SKIPPED:
                self._keep()
                raise NotConverged(
                    f"the loss has been no number for {MOST_SKIPPED} steps up to {now.step}; try a lower learning_rate "
                    f"or clip in the recipe (the last good state is kept in {str(self._run.out)!r})"
                )
            return
        now.skipped_in_a_row = 0
        self._optimiser.step()
        optimising.average(self._average, self._network, recipe.average, now.step - 1)
        for name, value in {"loss": loss, "gradient": norm, **parts}.items():
            now.sums[name] = now.sums.get(name, 0.0) + float(value)
        now.n_summed += 1
        if now.step % LINE_EVERY == 0:
            seconds = {"minutes": (time.monotonic() - self._since_s) / 60.0}
            means = {name: total / now.n_summed for name, total in now.sums.items()}
            now.curve.append({"step": now.step, "examples": now.examples, **seconds, **means})
            now.sums, now.n_summed = {}, 0

    def _validate(self) -> None:
        """Add the figures of the averaged weights on what was held out, and draw; the first device does."""
        import torch

        now = self._now
        if self._here.rank:
            return
        self._held_out = self._held_out or self._source.held_out(self._recipe.validation.examples)
        judged = copy.deepcopy(self._average).cpu()
        with torch.inference_mode():
            for split, held_out in self._held_out.items():
                for name, value in self._task.figures(judged, held_out).items():
                    now.figures.append({"step": now.step, "split": split, "name": name, "value": float(value)})
        found = [f"{row['split'].replace('_', ' ')} {row['name']} {row['value']:.4g}" for row in now.figures
                 if row["step"] == now.step]  # fmt: skip
        log.info("step %d: %s", now.step, "; ".join(found))
        now.seconds = time.monotonic() - self._since_s
        self._unless_full(lambda: curves.draw(self._run.out, now))

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
        now.seconds = self._saved_s - self._since_s
        if self._here.rank:
            return
        now.network, now.average = self._network.state_dict(), self._average.state_dict()
        now.optimiser = self._optimiser.state_dict()
        state.save(self._run.out, now)
        curves.write(self._run.out, now)


def tensors(batch: Example, device: Any) -> dict[str, Any]:
    """A batch of arrays as tensors on a device, pictures with their channels innermost."""
    import torch

    made: dict[str, Any] = {}
    for name, array in batch.items():
        tensor = torch.from_numpy(array).to(device)
        made[name] = tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor
    return made


def _arguments(recipe: Recipe) -> dict[str, Any]:
    return {key: value for key, value in recipe.network.items() if key != "kind"}
