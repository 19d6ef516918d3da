"""A membrane and a correction of it, as the touch that the target sensor would have recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.physics import bubble_camera, optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.generate.diffusion import Sampled, State
from pipeline.values.results import DepthMap, Touch, TouchStep

_HALF = 0.5


def corrected(first: Touch, target: SensorSpec, found: Sampled, seed: int | None, blur_mm: float = 0.0) -> Touch:
    """`first` with a sample's correction, drawn from the working grid to the target's own pixels.

    The membrane goes no deeper than the sensor can be pressed. `seed` is of the sensor's noise, None = no noise. All of
    the picture is told, `membrane.spread_mm` says how surely. `blur_mm` is of all of the membrane: a picture shows its
    slopes, and an edge whose place is unsure is in the middle of all pictures as wide as that.
    """
    at_first = first.membrane
    assert at_first is not None
    spread = freeze(_sized(found.spread_mm, target.camera.shape))
    image, told = _touch(at_first, target, found.last, seed, blur_mm)
    steps = [
        TouchStep(image=drawn, sigma=state.sigma, membrane=membrane)
        for state in found.states
        for drawn, membrane in (_touch(at_first, target, state, None, blur_mm),)
    ]
    return replace(
        first,
        image=image,
        membrane=replace(told, spread_mm=spread),
        known=freeze(np.ones(target.camera.shape, np.bool_)),
        notes=(*first.notes, *found.notes),
        steps=tuple(steps),
    )


def _touch(
    first: DepthMap, target: SensorSpec, state: State, seed: int | None, blur_mm: float
) -> tuple[Image | Floats, DepthMap]:
    shape = target.camera.shape
    surface = first.indentation_mm + _sized(state.residual_mm, shape)
    if blur_mm > 0.0:
        surface = _blurred(surface, blur_mm / target.pixel_mm)
    surface = np.minimum(surface, np.float32(target.limits.indentation_max_mm)).astype(np.float32)
    contact: Mask = first.contact.astype(np.float32) + _sized(state.contact, shape) > _HALF
    depth: Floats = (target.rest_depth_mm - surface).astype(np.float32)
    told = replace(first, indentation_mm=freeze(surface), depth_mm=freeze(depth), contact=freeze(contact))
    if target.kind == "gel":
        return optics.render(target, surface, seed=seed), told
    return bubble_camera.reading(target, depth, seed), told


def on_grid(field: Floats | Mask, shape: tuple[int, int]) -> Floats:
    """A field as the mean over the pixels of a coarser grid of the same view."""
    import cv2

    whole = np.asarray(field, np.float32)
    if whole.shape == shape:
        return whole
    return np.asarray(cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _blurred(field: Floats, by_px: float) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), by_px), np.float32)


def _sized(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return np.asarray(field, np.float32)
    return np.asarray(cv2.resize(np.array(field), shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
