"""A membrane and a correction of it, as the touch that the target sensor would have recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.touch.residual_diffusion import DenoisingState, ResidualSample
from pipeline.values.results import DepthMap, GeneratedTouch, TouchStep

_HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeUncertainty:
    """How far apart the places are where an edge may be that a coarse source told."""

    blur_mm: float = 0.0  # of all of the membrane
    contact_margin_mm: float = 0.0  # that contact goes beyond the middles of the source's pixels


NO_EDGE_UNCERTAINTY = EdgeUncertainty()


def render_correction(
    first: GeneratedTouch,
    target: SensorSpec,
    sample: ResidualSample,
    seed: int | None,
    edge_uncertainty: EdgeUncertainty = NO_EDGE_UNCERTAINTY,
) -> GeneratedTouch:
    """`first` with a sample's correction, drawn from the working grid to the target's own pixels.

    The membrane goes no deeper than the sensor can be pressed. `seed` is of the sensor's noise, None = no noise. All of
    the picture is told, `membrane.spread_mm` says how surely. A picture shows slopes, and an edge whose place is
    `unsure` is in the middle of all pictures as wide as that.
    """
    at_first = first.membrane
    assert at_first is not None
    spread = freeze(_sized(sample.expected_error_mm, target.camera.shape))
    image, told = _touch(at_first, target, sample.final, seed, edge_uncertainty)
    steps = [
        TouchStep(image=drawn, sigma=state.sigma, membrane=membrane)
        for state in sample.states
        for drawn, membrane in (_touch(at_first, target, state, None, edge_uncertainty),)
    ]
    return replace(
        first,
        image=image,
        membrane=replace(told, expected_error_mm=spread),
        in_view=freeze(np.ones(target.camera.shape, np.bool_)),
        notes=(*first.notes, *sample.notes),
        steps=tuple(steps),
    )


def _touch(
    first: DepthMap, target: SensorSpec, state: DenoisingState, seed: int | None, unsure: EdgeUncertainty
) -> tuple[Image | Floats, DepthMap]:
    shape = target.camera.shape
    surface = first.indentation_mm + _sized(state.residual_mm, shape)
    if unsure.blur_mm > 0.0:
        surface = _blurred(surface, unsure.blur_mm / target.pixel_mm)
    surface = np.minimum(surface, np.float32(target.limits.indentation_max_mm)).astype(np.float32)
    before = _grown(first.contact, unsure.contact_margin_mm / target.pixel_mm)
    contact: Mask = before.astype(np.float32) + _sized(state.contact_correction, shape) > _HALF
    depth: Floats = (target.rest_depth_mm - surface).astype(np.float32)
    told = replace(
        first, indentation_mm=freeze(surface), depth_mm=freeze(depth), contact=freeze(contact), is_generated=True
    )
    return target.sensor_kind.simulate_image(target, surface, depth, seed), told


def resample_to_grid(field: Floats | Mask, shape: tuple[int, int]) -> Floats:
    """A field as the mean over the pixels of a coarser grid of the same view."""
    import cv2

    whole = np.asarray(field, np.float32)
    if whole.shape == shape:
        return whole
    return np.asarray(cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _grown(mask: Mask, by_px: float) -> Mask:
    import cv2

    if by_px <= 0.0 or not mask.any():
        return mask
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)) <= by_px


def _blurred(field: Floats, by_px: float) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), by_px), np.float32)


def _sized(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return np.asarray(field, np.float32)
    return np.asarray(cv2.resize(np.array(field), shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
