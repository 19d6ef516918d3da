"""Depth of a gel or contact of a bubble by the U-Nets of the paper's lab, with weights that the
user gives.

A gel's indentation is that of gelslim_depth. A bubble measures its membrane; the network says where
it touches, from the imprint in 8 bits of the range that the paper's latent diffusion uses, too
(touch2touch, masks for ICP).
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.graph import Skipped
from pipeline.core.params import NoParams
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_depth_map
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric
from pipeline.stages.depth.frame_checks import see_by_frame
from pipeline.stages.networks import published_weights, weights_registry
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.touch_formats import BUBBLE
from pipeline.stages.networks.weights import NoWeights, Weights

_NOT_SHIPPED = NoWeights(
    why="no weights of a U-Net are shipped; give yours as --weights depth=unet_bigdata.pth"
)
_TOUCHES = 1  # class of the mask network


def select_weights(
    source: SensorSpec, _target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The user's weights, where they are for this kind of sensor; none are shipped."""
    found = (
        _NOT_SHIPPED
        if file is None
        else weights_registry.load_file(file, published_weights.read_unet)
    )
    if isinstance(found, NoWeights) or found.card.get("task", "").endswith(source.kind):
        return found
    return NoWeights(
        why=f"the weights {found.name!r} predict {found.card.get('task')}, not of a {source.kind}"
    )


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: Any,
    _params: NoParams,
    progress: Progress,
) -> DepthMap | Skipped:
    """Indentation, depth and contact of a frame, on its own pixels.

    Raises what the physical estimate raises.
    """
    still = photometric.skip_without_contact(frame, source, calibration, photometric.DepthParams())
    if still is not None:
        return Skipped(output=still, reason=still.notes[0])
    assert frame.reference is not None  # checked
    seen_by = see_by_frame(source, frame)
    if frame.is_depth:
        physical = photometric.estimate_depth(
            frame, source, calibration, photometric.DepthParams(), progress
        )
        touches = predict_contact(
            network,
            source.sensor_kind.compute_relative_change(frame.image, frame.reference)[..., 0],
        )
        return replace(physical, contact=freeze(touches & np.isfinite(physical.depth_mm)))
    progress.step(0.5, "running the network")
    indentation_mm = predict_indentation_mm(network, frame.image, frame.reference)
    least_mm = source.limits.contact_min_mm
    note = f"these weights predict no contact: it is where the indentation exceeds {least_mm:g} mm"
    return make_depth_map(
        seen_by.rest_depth_mm,
        indentation_mm,
        indentation_mm > least_mm,
        seen_by.camera,
        notes=(note,),
    )


def predict_indentation_mm(network: Any, image: NDArray[Any], reference: NDArray[Any]) -> Floats:
    """(rows, cols) of images (rows, cols, 3) in 0..255: minus the depth that gelslim_depth
    predicts.
    """
    import torch

    images = (
        torch.from_numpy(np.moveaxis(array, 2, 0).astype(np.float32)[None])
        for array in (image, reference)
    )
    with reproducible_inference():
        return -network.predict_depth_mm(*images)[0, 0].numpy()


def predict_contact(network: Any, imprint_mm: Floats) -> Mask:
    """(rows, cols) of a displacement toward the camera.

    Beyond the published range it is clipped.
    """
    import torch

    assert BUBBLE.image_range is not None
    low_mm, high_mm = BUBBLE.image_range
    share = (np.clip(imprint_mm, low_mm, high_mm) - low_mm) / (high_mm - low_mm)
    shown = (255.0 * share).astype(np.uint8).astype(np.float32) / np.float32(255.0)
    with reproducible_inference():
        return network(torch.from_numpy(shown)[None, None])[0].argmax(0).numpy() == _TOUCHES
