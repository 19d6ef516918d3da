"""Results of the stages. Arrays are read-only; `notes` are sentences that the app shows.

`source_index` points to the stage before (flat, C order; -1 = none), so that a pixel can be traced
in both directions.
"""

import math
from dataclasses import field

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image, Indices, Mask, Reals, freeze
from pipeline.core.derived import derive_once
from pipeline.core.digests import UNDIGESTED
from pipeline.core.errors import find_uncertain_contact
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera

SAME_SURFACE_MM = 0.2  # mm; a point this close behind the depth of its pixel counts as visible


@frozen
class DepthErrorModel:
    """Correlated error of a measured surface in contact, without the noise of single pixels."""

    rms_mm: float
    correlation_mm: float  # distance at which errors correlate by exp(-1/2)


@frozen
class DepthMap:
    """Indentation, depth and contact of a sensor's membrane, in that sensor's frame."""

    # (rows, cols) rest - depth: 0 at rest, positive toward the camera; NaN = no value
    indentation_mm: Floats
    depth_mm: Floats  # (rows, cols) z of the membrane surface; NaN = no value
    contact: Mask  # (rows, cols) membrane touches the object (paper's M_S')
    camera: Camera  # of this grid
    source_index: Indices  # (rows, cols) -> pixel of the frame
    notes: tuple[str, ...] = ()
    # (rows, cols) inside the field of view, where "no contact" is known; None = everywhere
    in_view: Mask | None = None
    error: DepthErrorModel | None = None  # of the measurement; None = not known
    # (rows, cols) expected mean error; NaN = no value, None = not predicted
    expected_error_mm: Floats | None = None
    # by a network, not measured: no pixel is better known than `expected_error_mm`
    is_generated: bool = False
    # (rows, cols) z of the object, also where the membrane bridges it; NaN = not predicted, None =
    # only in contact
    object_depth_mm: Floats | None = None
    # (rows, cols) z as a depth camera measured it, with its noise; NaN = no value, None = not
    # measured directly
    measured_depth_mm: Floats | None = None

    @property
    def is_uncertain(self) -> bool:
        """Whether there may be a contact that was not measured."""
        return find_uncertain_contact(self.notes) is not None


@frozen
class Cloud:
    """Contact pixels as points in the target frame (paper's P_T)."""

    points_mm: Floats  # (n, 3)
    source_index: Indices  # (n,) -> pixel of DepthMap
    grid_shape: tuple[int, int]  # of that DepthMap, to find neighbours
    # (4, 3) corners of the source's image on its surface, in order: nothing is known outside
    field_of_view_mm: Floats
    stride: int = 1  # rows and columns between neighbouring points
    notes: tuple[str, ...] = ()
    error: DepthErrorModel | None = None  # of the source depth


@frozen
class TargetDepth:
    """The cloud projected to the target's camera (paper's D_T'' and M_T'')."""

    depth_mm: Floats  # (rows, cols) z in the target frame; NaN = nothing there
    contact: Mask  # (rows, cols) visible and beyond the target's rest surface: SDF <= 0
    indentation_mm: Floats  # (rows, cols) rest - depth where `contact`, else 0; NaN never
    camera: Camera
    source_index: Indices  # (rows, cols) -> point of Cloud
    in_view: Mask  # (rows, cols) inside the source's field of view, where "no contact" is known
    notes: tuple[str, ...] = ()
    # (n,) of Cloud -> its pixel; -1 = outside, hidden or cut away
    pixel_of_point: Indices | None = None
    error: DepthErrorModel | None = None  # of the source depth


@frozen
class TouchStep:
    """One denoising step of a generated touch, its expected result.

    Or the touch of one pose of the object.
    """

    image: Image | Floats  # as of GeneratedTouch
    sigma: float  # noise level in units of the correction; 0 = the sample, NaN = a pose's touch
    membrane: DepthMap

    @property
    def label(self) -> str:
        """What it is, in two words."""
        return "a pose" if math.isnan(self.sigma) else f"noise {self.sigma:.2g}"


@frozen
class SealedMembrane:
    """Shape of a bubble's membrane and pressure of its air, from which a search can start."""

    deviation_mm: Doubles | Floats  # (ny, nx) of the lattice, from the rest dome
    over_kpa: float = 0.0  # rise of the pressure
    converged: bool = True


@frozen
class GeneratedTouch:
    """The generated tactile image of the target, and its membrane where the method computes it."""

    # (rows, cols, 3) uint8 RGB, or (rows, cols) float32 depth_mm for a bubble
    image: Image | Floats
    camera: Camera
    source_index: Indices  # (rows, cols) -> pixel of the stage before; -1 everywhere if not known
    # (rows, cols) as in TargetDepth; True for a method that generates outside the source's field of
    # view
    in_view: Mask
    membrane: DepthMap | None = None  # of this image; None = only the image is known
    notes: tuple[str, ...] = ()
    # noisiest first; the best pose last
    steps: tuple[TouchStep, ...] = field(default=(), metadata=UNDIGESTED)
    # (rows, cols) mm, recorded reference of a bubble; None = described rest
    reference: Floats | None = None
    # a bubble's by physics, where the next touch of a sequence may start; None = none
    pressed: SealedMembrane | None = field(default=None, metadata=UNDIGESTED)


@frozen
class PoseStep:
    """One iteration of the registration."""

    sensor_from_object: Doubles  # (4, 4) mm
    rmse_mm: float
    fitness: float  # share of scene points with a partner within the distance limit
    max_correspondence_mm: float = math.inf  # that limit


@frozen
class ObjectPose:
    """Pose of the object in the target frame.

    `sensor_from_object` is None where it cannot be estimated.
    """

    sensor_from_object: Doubles | None  # (4, 4) mm
    # (6, 6) of (rotation rad, translation mm) about the scene centroid
    covariance: Doubles | None = None
    observable: Doubles | None = None  # (6, 6) projector onto the observable directions
    weak_directions: tuple[str, ...] = ()  # unobservable directions such as "moves along y"
    rmse_mm: float = math.nan
    fitness: float = 0.0
    scene_mm: Floats  # (n, 3) registered points, target frame
    source_index: Indices  # (n,) -> pixel of the DepthMap of the generated touch
    steps: tuple[PoseStep, ...] = field(default=(), metadata=UNDIGESTED)
    stop_reason: str = field(default="", metadata=UNDIGESTED)  # why the registration ended
    starts_tried: int = 0
    notes: tuple[str, ...] = ()
    # (4, 4) each, best first: other poses that fit this touch as well
    alternatives: tuple[Doubles, ...] = ()

    @property
    def matrix(self) -> Doubles | None:
        """`sensor_from_object` (4, 4): maps points of the object's mesh in mm to the target's
        frame.
        """
        return self.sensor_from_object


@frozen
class PressedMembrane(DepthMap):
    """Membrane into which an object was pressed at a known pose."""

    object_pose: ObjectPose


def make_depth_map(
    rest_mm: Reals,
    indentation_mm: Floats,
    contact: Mask,
    camera: Camera,
    notes: tuple[str, ...] = (),
) -> DepthMap:
    """The membrane that is indented (rows, cols) from its rest surface, with each pixel as its
    own source.
    """
    return DepthMap(
        indentation_mm=freeze(indentation_mm),
        depth_mm=freeze((rest_mm - indentation_mm).astype(np.float32)),
        contact=freeze(contact),
        camera=camera,
        source_index=make_pixel_index(contact.shape),
        notes=notes,
    )


@derive_once
def make_pixel_index(shape: tuple[int, int]) -> Indices:
    """0, 1, 2, ... in C order (rows, cols); cached per shape."""
    return freeze(np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape))
