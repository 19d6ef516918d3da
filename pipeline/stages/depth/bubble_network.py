"""A bubble's reading by a network: the object's own surface, where it touches, and how sure that is.

Physics finds the load behind a noisy membrane; a network has seen many objects and noises, and also tells how the
object goes on beside the contact, where a membrane bridges what a stiffer sensor would feel. It reads pixels of about
`WORK_MM`; finer and coarser depth images are brought there and back.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.errors import ShapeError
from pipeline.base.stage_warnings import AT_BORDER
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import contact
from pipeline.stages.depth.bubble_depth import compute_displacement
from pipeline.stages.depth.bubble_network_input import WORKING_PIXEL_MM, estimate_rest_surface, make_network_input
from pipeline.stages.depth.bubble_network_output import BubblePrediction, decode_prediction
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import DepthMap

BubbleNetwork = Callable[[Floats], Floats]  # from a picture (CHANNELS, rows, cols) to an answer (OUTPUTS, rows, cols)
_AS_IT_IS = 1.4  # times finer or coarser than `WORK_MM` that the network was taught on
_ISLAND_MM2 = 2.0  # smaller touches are noise
_HALF = 0.5
_TOLD = 0.6  # likelihood from which the object's surface is told; 0.5 fills rings, 0.7 loses faint touches


def estimate_depth(
    frame: TactileFrame, source: SensorSpec, network: BubbleNetwork, *, certainty: float = _HALF, least_mm: float
) -> DepthMap:
    """The depth of one bubble frame that has been checked, as a network of `BubbleReading` tells it.

    Contact is where the network holds it for likelier than `certainty`, and the membrane moved by more than `least_mm`.
    `object_mm` is the object's surface where it touches and close by, `spread_mm` the error to be expected of it and of
    the membrane beside it.
    """
    if frame.reference is None:
        raise ShapeError("a bubble's depth needs a reference depth image")
    notes: list[str] = []
    moved, rest, read, known = compute_displacement(
        frame.reference, frame.image, source.limits.indentation_max_mm, notes
    )
    said = _read(moved, rest, read, source.pixel_mm, network)
    islands = max(4, round(_ISLAND_MM2 / source.pixel_mm**2))
    touched = contact.remove_specks((said.contact > certainty) & known & (said.displacement_mm > least_mm), islands)
    told = _reaching(touched, ((said.object_in_view > _TOLD) & known) | touched)
    if not touched.any():
        notes.append("nothing touches the sensor")
    elif np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]]).any():
        notes.append(AT_BORDER)
    nothing, rest = (
        np.float32(np.nan),
        estimate_rest_surface(rest, read, source.pixel_mm),
    )  # its noise is no part of the membrane
    return DepthMap(
        indentation_mm=freeze(np.where(known, said.displacement_mm, nothing)),
        depth_mm=freeze(np.where(known, rest - said.displacement_mm, nothing)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=make_pixel_index(moved.shape),
        notes=tuple(notes),
        object_depth_mm=freeze(np.where(told, rest - said.object_displacement_mm, nothing)),
        expected_error_mm=freeze(np.where(known, said.expected_error_mm, nothing)),
    )


def _read(moved: Floats, rest: Floats, read: Mask, pixel_mm: float, network: BubbleNetwork) -> BubblePrediction:
    """What the network says, on the grid of the frame."""
    (rows, cols), scale = moved.shape, pixel_mm / WORKING_PIXEL_MM
    size = (
        (rows, cols)
        if 1 / _AS_IT_IS < scale < _AS_IT_IS
        else (max(8, round(rows * scale)), max(8, round(cols * scale)))
    )
    seen = _sized(read.astype(np.float32), size) > _HALF
    looked_at = make_network_input(_sized(moved, size), _sized(rest, size), seen, pixel_mm * rows / size[0])
    said = decode_prediction(network(looked_at.channels), looked_at.smooth_displacement_mm)
    return BubblePrediction(*(_sized(field, (rows, cols)) for field in said))


def _sized(image: Floats, size: tuple[int, int]) -> Floats:
    """An image (rows, cols) with another number of pixels over the same view."""
    import cv2

    if image.shape == size:
        return image
    how = cv2.INTER_AREA if size[0] < image.shape[0] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size[::-1], interpolation=how), np.float32)


def _reaching(touched: Mask, observed: Mask) -> Mask:
    """The regions of `told` in which something touches."""
    import cv2

    if not touched.any():
        return touched
    _, regions = cv2.connectedComponents(observed.astype(np.uint8), connectivity=8)
    regions = np.asarray(regions, np.int32)
    return observed & np.isin(regions, np.unique(regions[touched]))
