"""What each stage hands on. Arrays are read-only; `notes` are plain sentences that the app shows as they are.

`source_index` always points one stage back (flat, C order; -1 = none): chains of look-ups follow a pixel both ways.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pipeline.base.arrays import Doubles, Floats, Image, Indices, Mask
from pipeline.engine.digests import UNDIGESTED
from pipeline.geometry.camera import Camera


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthErrorModel:
    """How far a measured surface is off where it touches, beside the noise of single pixels."""

    rms_mm: float
    correlation_mm: float  # errors a and b this far apart go together by exp(-1/2)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthMap:
    """How far a sensor's membrane is pushed in, and where it is, in that sensor's frame."""

    indentation_mm: Floats  # (rows, cols) rest - depth: 0 untouched, positive toward the camera; NaN = no value
    depth_mm: Floats  # (rows, cols) z of the membrane surface; NaN = no value
    contact: Mask  # (rows, cols) membrane touches the object (paper's M_S')
    camera: Camera  # of this very grid
    source_index: Indices  # (rows, cols) -> pixel of the reading it was made from
    notes: tuple[str, ...] = ()
    in_view: Mask | None = None  # (rows, cols) where "no contact" means anything; None = everywhere
    error: DepthErrorModel | None = None  # of the measurement that it comes from; None = computed without one
    expected_error_mm: Floats | None = (
        None  # (rows, cols) mean error to be expected of each pixel; NaN = no value, None = not told
    )
    is_generated: bool = False  # by a network, and not measured: all of it is known no better than `spread_mm`
    object_depth_mm: Floats | None = (
        None  # (rows, cols) z of the object itself, also beside the contact where a membrane
    )
    # bridges it; NaN = not told, None = the membrane in contact is all that is known of it


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """The contact pixels as points in the target sensor's frame (paper's P_T)."""

    points_mm: Floats  # (n, 3)
    source_index: Indices  # (n,) -> pixel of DepthMap
    grid_shape: tuple[int, int]  # of that DepthMap, so that neighbours can be found again
    field_of_view_mm: (
        Floats  # (4, 3) corners of the source's whole image on its surface, in turn: beyond them nothing is known
    )
    stride: int = 1  # every stride-th row and column of it was looked at: neighbours are this far apart
    notes: tuple[str, ...] = ()
    error: DepthErrorModel | None = None  # of the depth that it comes from


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetDepth:
    """The cloud as the target sensor's camera would see it (paper's D_T'' and M_T'')."""

    depth_mm: Floats  # (rows, cols) z in the target frame; NaN = nothing there
    contact: Mask  # (rows, cols) seen and pushed through the target's rest surface: SDF <= 0
    indentation_mm: Floats  # (rows, cols) rest - depth where `contact`, else 0; NaN never
    camera: Camera
    source_index: Indices  # (rows, cols) -> point of Cloud
    in_view: Mask  # (rows, cols) inside what the source could see: only here does "no contact" mean anything
    notes: tuple[str, ...] = ()
    pixel_of_point: Indices | None = None  # (n,) of Cloud -> the pixel that shows it, -1 = outside, hidden or cut away
    coverage: Floats | None = None  # (rows, cols) 0..1, share of each pixel in contact; None = not asked for
    error: DepthErrorModel | None = None  # of the depth that it comes from


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchStep:
    """What a touch was expected to be on the way to its sample."""

    image: Image | Floats  # as that of the touch
    sigma: float  # of the noise that it was seen through, in units of the correction; 0 = the sample
    membrane: DepthMap


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneratedTouch:
    """What the target sensor would have recorded, and the membrane behind that picture where the method knows it."""

    image: Image | Floats  # (rows, cols, 3) uint8 RGB, or (rows, cols) float32 depth_mm for a bubble
    camera: Camera
    source_index: Indices  # (rows, cols) -> pixel of what it was made from; -1 everywhere where a method cannot tell
    in_view: Mask  # (rows, cols) as in TargetView; everywhere for a method that guesses beyond the source's window
    membrane: DepthMap | None = None  # of the very picture; None = only the picture is known
    notes: tuple[str, ...] = ()
    steps: tuple[TouchStep, ...] = field(default=(), metadata=UNDIGESTED)  # kept states, the noisiest first
    reference: Floats | None = None  # (rows, cols) a recorded bubble's own untouched reading; None = the described rest


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseStep:
    """One kept iteration of the registration."""

    sensor_from_object: Doubles  # (4, 4) mm
    rmse_mm: float
    fitness: float  # share of scene points with a partner within the distance limit
    max_correspondence_mm: float = math.inf  # that limit: points farther from the object count for nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectPose:
    """Where the object is in the target sensor's frame; `sensor_from_object` is None when that cannot be said."""

    sensor_from_object: Doubles | None  # (4, 4) mm
    covariance: Doubles | None  # (6, 6) of (rotation rad, translation mm) about the scene centroid
    observable: Doubles | None  # (6, 6) projector onto the directions the data determine
    weak_directions: tuple[str, ...]  # the other directions in words, such as "slides along y"
    rmse_mm: float
    fitness: float
    scene_mm: Floats  # (n, 3) the points that were registered, target frame
    source_index: Indices  # (n,) -> pixel of the felt DepthMap
    steps: tuple[PoseStep, ...] = field(default=(), metadata=UNDIGESTED)
    stop_reason: str = field(default="", metadata=UNDIGESTED)  # why the registration ended, in words
    starts_tried: int = 0
    notes: tuple[str, ...] = ()
    alternatives: tuple[Doubles, ...] = ()  # (4, 4) each, best first: other poses that this touch fits as well
