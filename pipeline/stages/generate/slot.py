"""The slot *touch*: what the target sensor would have recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.params import NoParams
from pipeline.engine.graph import Method, unless
from pipeline.evaluation.metrics import picture_figures
from pipeline.pictures.layers import Layer, reading_layer, surface_layer
from pipeline.pictures.picture import Picture, of_reading
from pipeline.stages import known_truth
from pipeline.stages.follow import element_of
from pipeline.stages.generate import latent, picture_to_touch, stage, view_to_touch, vqvae
from pipeline.stages.generate.diffusion import DiffusionParams, draft
from pipeline.stages.generate.latent import LatentParams
from pipeline.stages.learned import learned
from pipeline.stages.slot import Curve, Facts, Mark, Seen, Slot, Way
from pipeline.values.results import Touch

PHYSICS = Method(
    slot="touch",
    name="physics",
    title="Physical render",
    help="the target's gel or membrane pressed onto the view, and photographed",
    run=unless(stage.without_contact, stage.generate),
    params=stage.GenerateParams,
    reads=("view", "target"),
    version=3,
)
T2D2 = Method(
    slot="touch",
    name="t2d2",
    title="T2D2, compact diffusion",
    help="the physical render, and what a network that knows the target's touches adds to it",
    run=unless(view_to_touch.without_contact, learned(view_to_touch.generate, instead=PHYSICS)),
    params=DiffusionParams,
    reads=(*PHYSICS.reads, "touch_weights"),
    weights=view_to_touch.weights,
    draft=draft,
    version=4,
)
T2T = Method(
    slot="touch",
    name="t2t",
    title="T2T, compact diffusion",
    help="the target's touch from the source's reading, as pairs have taught it; where one step is unsure, physics",
    run=learned(picture_to_touch.generate, instead=picture_to_touch.BY_PHYSICS),
    params=DiffusionParams,
    reads=(*picture_to_touch.READS, "touch_weights"),
    weights=picture_to_touch.weights,
    draft=draft,
    version=5,
)
LATENT = Method(
    slot="touch",
    name="latent",
    title="T2T, latent diffusion",
    help="the paper's own: 200 steps from noise, guided by what an encoder sees in the source's picture",
    run=learned(latent.generate, instead=picture_to_touch.BY_PHYSICS),
    params=LatentParams,
    reads=(*picture_to_touch.READS, "touch_weights"),
    weights=latent.weights,
    draft=latent.draft,
)
VQVAE = Method(
    slot="touch",
    name="vqvae",
    title="VQ-VAE, the paper's baseline",
    help="picture to picture at 128 x 128 through a codebook; needs no depth",
    run=learned(vqvae.generate, instead=picture_to_touch.BY_PHYSICS),
    params=NoParams,
    reads=(*picture_to_touch.READS, "touch_weights"),
    weights=vqvae.weights,
)


def _picture(touch: Touch, seen: Seen) -> Picture:
    membrane = touch.membrane
    return of_reading(
        touch.image, touch.camera, seen.target, seen.display,
        depth_mm=None if membrane is None else membrane.depth_mm,
        contact=None if membrane is None else membrane.contact, reference=touch.reference, recorded=False,
    )  # fmt: skip


def _layers(touch: Touch, seen: Seen, picture: Picture) -> tuple[Layer, ...]:
    """The target's membrane under the generated touch, wearing its picture."""
    at = touch.membrane
    if at is None:
        return (reading_layer("touch", touch.image, touch.camera, picture.pixels, seen.target),)
    times = seen.display.stretch(seen.target)
    return (surface_layer("touch", at.depth_mm, at.indentation_mm, touch.camera, picture.pixels, times),)


def _follow(touch: Touch, before: Mark) -> Mark:
    index = element_of(touch.source_index, before.index)
    if index < 0:
        untouched = touch.membrane is not None and not touch.membrane.contact.any()
        text = "generated untouched" if untouched else "this method does not tell where a pixel comes from"
        return Mark(slot="touch", index=-1, text=text)
    row, col = divmod(index, touch.camera.cols)
    if touch.image.ndim == 2:
        text = f"{_from_rest(touch, row, col)}{float(touch.image[row, col]):.2f} mm from the camera"
    else:
        text = "generated rgb {} {} {}".format(*(int(v) for v in touch.image[row, col]))
    return Mark(slot="touch", index=index, row=row, col=col, point_mm=before.point_mm, text=text)


def _from_rest(touch: Touch, row: int, col: int) -> str:
    """How far a bubble's membrane went, where that is known, and which way."""
    if touch.membrane is None:
        return ""
    moved_mm = float(touch.membrane.indentation_mm[row, col])
    return f"{abs(moved_mm):.2f} mm {'out' if moved_mm < 0 else 'in'}, "


def _states(touch: Touch) -> tuple[Touch, ...]:
    return tuple(replace(touch, image=step.image, membrane=step.membrane, steps=()) for step in touch.steps)


def _way(touch: Touch) -> Way | None:
    """How far each state is from the one before and from the last, and from which on nothing changes to speak of."""
    if not touch.steps:
        return None
    heights = [np.nan_to_num(step.membrane.indentation_mm) for step in touch.steps]
    off = [heights[0] * 0, *(b - a for a, b in pairwise(heights))]
    last_mm = tuple(_rms_mm(h - heights[-1]) for h in heights)
    span_mm = max(float(np.ptp(heights[-1])), 1e-9)
    settled = next(k for k, h in enumerate(heights) if _most(h - heights[-1]) <= span_mm / 255)
    return Way(
        curves=(
            Curve(name="changed", unit="mm", values=tuple(_rms_mm(o) for o in off)),
            Curve(name="from the last", unit="mm", values=last_mm),
        ),
        told=f"settled at {settled + 1} of {len(heights)}: from there on 99 % of the pixels stay within 1/255 of the "
        "whole indentation; it ends as all steps that were asked for are done",
        steps=tuple(f"seen through noise of {s.sigma:.3g} units, {d:.3g} mm (rms) from the last"
                    for s, d in zip(touch.steps, last_mm, strict=True)),
    )  # fmt: skip


def _rms_mm(gap: Floats) -> float:
    return float(np.sqrt((gap.astype(np.float64) ** 2).mean()))


def _most(gap: Floats) -> float:
    return float(np.percentile(np.abs(gap), 99.0))


def _figures(touch: Touch, facts: Facts) -> Mapping[str, float]:
    return {} if facts.target_frame is None else picture_figures(touch.image, facts.target_frame)


SLOT = Slot(
    name="touch",
    title="Generated touch",
    legend="target's membrane",
    place="target",
    methods=(PHYSICS, T2D2, T2T, LATENT, VQVAE),
    picture=_picture,
    layers=_layers,
    follow=_follow,
    figures=_figures,
    truth=known_truth.touch,
    scrubs=True,
    states=_states,
    way=_way,
)
