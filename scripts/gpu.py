"""Trainings for a GPU, each one command of 6 to 12 minutes on an H100, in this order.

    python scripts/gpu.py latent_t2d2 OUT      # latent T2D2 onto a Soft Bubble and a GelSlim
    python scripts/gpu.py latent_t2t OUT       # latent T2T, both directions, at any placement
    python scripts/gpu.py depth_anything OUT   # a Depth Anything V2 of 6 million parameters
    python -m benchmarks.gpu                   # time and error of the lab's latent diffusion

A command that was cut off continues where it stopped, at most a minute before, and one that is done
ends at once. Touches are simulated on all cores first and kept in OUT/presses. Weights are
OUT/NAME.safetensors; `tactoscope evaluate --weights METHOD=FILE` measures them. `--smoke` is two
steps of everything, tiny, on any machine.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.cli.train import run_with_progress_bar
from pipeline.core.params import Value
from pipeline.lab.training.loop import TrainingRun
from pipeline.lab.training.recipe import Recipe, load_recipe, override_training
from pipeline.lab.training.run_folder import export_run

TARGETS = ("soft_bubble", "gelslim")
# latents of 16 x 16 where the recipes have 8 x 8
NETWORK = {
    "side": 128,
    "width": 80,
    "channel_multipliers": "1 2 3",
    "blocks": 2,
    "attention": "2 4",
    "autoencoder_width": 32,
}
SMALL = {
    "side": 32,
    "width": 8,
    "channel_multipliers": "1 2",
    "autoencoder_width": 8,
}
TRAINING = {"batch": 128, "n_cached_examples": 16000, "precision": "bf16"}
DEPTH = {"encoder": "vitt", "side": 140}


def train_latent_t2d2(out: Path, *, smoke: bool) -> None:
    """Latent T2D2 onto both targets: 1 minute of the autoencoder, 2.5 of the denoiser each."""
    for target in TARGETS:
        recipe = _enlarge("latent_t2d2", target, smoke=smoke)
        _train_denoiser(recipe, f"latent_t2d2_{target}", out, 2.5, smoke=smoke)


def train_latent_t2t(out: Path, *, smoke: bool) -> None:
    """Latent T2T in both directions: 3.5 minutes each, on the autoencoders of latent T2D2."""
    for source, target in (TARGETS, TARGETS[::-1]):
        recipe = _enlarge("latent_gelslim", target, smoke=smoke)
        if source == "gelslim":  # colours beside a bubble's heights
            recipe = replace(recipe, network={**recipe.network, "condition_inputs": 5})
        _train_denoiser(recipe, f"latent_{source}_to_{target}", out, 3.5, smoke=smoke)


def train_depth_anything(out: Path, *, smoke: bool) -> None:
    """A Depth Anything V2 of 192 channels with the contact head, on a GelSlim: 6 minutes."""
    recipe = load_recipe("depth_anything")
    side = 28 if smoke else DEPTH["side"]
    recipe = replace(
        recipe,
        network={**recipe.network, **DEPTH, "side": side},
        settings=replace(recipe.settings, side=side),
        optimiser=replace(recipe.optimiser, learning_rate=5e-4, warm_up_steps=200),
        rate_factors={},  # nothing of it is trained before
    )
    recipe = override_training(recipe, **{**TRAINING, "batch": 64, "n_cached_examples": 8000})
    _train(recipe, "depth_anything_gelslim", out, 6.0, smoke=smoke)


def _enlarge(name: str, target: str, *, smoke: bool) -> Recipe:
    recipe = load_recipe(name)
    size: Mapping[str, Value] = SMALL if smoke else NETWORK
    return replace(
        override_training(recipe, **TRAINING),
        network={**recipe.network, **size},
        settings=replace(
            recipe.settings, target=target, side=size["side"], n_presses=2 if smoke else 3000
        ),
        optimiser=replace(recipe.optimiser, ema_decay=0.999),
    )


def _train_denoiser(recipe: Recipe, name: str, out: Path, minutes: float, *, smoke: bool) -> None:
    """Train on the target's autoencoder, which is trained first where it is not there."""
    target = recipe.settings.target
    first = load_recipe("latent_autoencoder" + ("_gelslim" if target == "gelslim" else ""))
    autoencoder = replace(
        override_training(first, **{**TRAINING, "precision": "float32"}),
        network={**first.network, **_sizes(recipe)},
        settings=replace(
            first.settings, side=recipe.settings.side, n_presses=recipe.settings.n_presses
        ),
    )
    file = _train(autoencoder, f"autoencoder_{target}", out, 1.0, smoke=smoke)
    recipe = replace(
        override_training(recipe, initial_weights=str(file)),
        settings=replace(recipe.settings, autoencoder=str(file)),
    )
    _train(recipe, name, out, minutes, smoke=smoke)


def _sizes(recipe: Recipe) -> Mapping[str, Value]:
    return {name: recipe.network[name] for name in NETWORK if name in recipe.network}


def _train(recipe: Recipe, name: str, out: Path, minutes: float, *, smoke: bool) -> Path:
    """Train or continue, and export in 16 bits; the file."""
    if hasattr(recipe.settings, "folder"):
        recipe = replace(recipe, settings=replace(recipe.settings, folder=str(out / "presses")))
    if smoke:
        recipe = override_training(recipe, batch=2, n_cached_examples=4, steps=2)
        validation = replace(recipe.validation, n_evaluations=1, n_examples=1)
        recipe = replace(recipe, validation=validation)
    run = TrainingRun(
        recipe=recipe,
        folder=out / name,
        resume=True,
        max_minutes=None if smoke else minutes,
        n_workers=0 if smoke else os.cpu_count() or 1,
        command=f"python scripts/gpu.py, {name}",
    )
    run_with_progress_bar(run)
    file = out / f"{name}.safetensors"
    export_run(out / name, file, half=True)
    return file


JOBS = {
    "latent_t2d2": train_latent_t2d2,
    "latent_t2t": train_latent_t2t,
    "depth_anything": train_depth_anything,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one job."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("job", choices=list(JOBS))
    parser.add_argument("out", type=Path)
    parser.add_argument("--smoke", action="store_true", help="two tiny steps")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    JOBS[given.job](given.out, smoke=given.smoke)


if __name__ == "__main__":
    main()
