"""Depth by Depth Anything V2, the paper's depth network, with weights that the user gives."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.errors import StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.graph import Skipped
from pipeline.core.params import setting
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.depth_anything_input import PATCH_PX, prepare_image, resize_to_patches
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.published_weights import read_depth_anything
from pipeline.stages.networks.weights import NoWeights, Weights

OutputKind = Literal["as trained", "metric", "distance", "relative"]
# largest distance in the tests of MMintLab/depth_anything_v2; it trained up to 200, too
_USUAL_DISTANCE_MM = 120.0
_NOT_SHIPPED = NoWeights(
    why="no weights of Depth Anything V2 are shipped; give yours as --weights FILE, such as "
    "depth_anything_v2_vits.pth"
)


@frozen
class DepthAnythingParams:
    """Input size and output kind of the network."""

    shorter_side_px: int = setting(
        0,
        "Shorter side",
        unit="px",
        low=0,
        high=1400,
        step=14,
        help="of the image that the network sees; 0 = as it was trained",
        source="Yang et al. 2024: 518 px, in patches of 14",
    )
    largest_mm: float = setting(
        0.0,
        "Largest output",
        unit="mm",
        low=0.0,
        high=1000.0,
        step=0.1,
        help="indentation or distance of an output of 1; 0 = as the weights say, else the "
        "sensor's limit or 120 mm",
        source="Yang et al. 2024, metric head: a sigmoid times the largest depth",
    )
    output_kind: OutputKind = setting(
        "as trained",
        "Output",
        choices=OutputKind,
        help="metric: a share of the largest indentation; distance: from the camera, a share of "
        "the largest; "
        "relative: without unit, fitted to the physical estimate",
        source="Yang et al. 2024, both heads; relative depth up to scale and shift: Ranftl et al. "
        "2022",
    )


def select_weights(
    _source: SensorSpec, _target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The user's weights; none are shipped."""
    return _NOT_SHIPPED if file is None else weights_registry.load_file(file, read_depth_anything)


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: Any,
    params: DepthAnythingParams,
    progress: Progress,
) -> DepthMap | Skipped:
    """Indentation, depth and contact of a frame as the network predicts them, on the frame's own
    pixels.

    The membrane at rest comes from the physical estimate, and so does the scale of a relative
    output. Raises what the physical estimate raises.
    """
    physical = photometric.run_physics(
        frame, source, calibration, photometric.DepthParams(), progress
    )
    if isinstance(physical, Skipped):
        return physical
    progress.step(0.5, "running the network")
    assert frame.reference is not None  # checked by the physical estimate
    image = resize_to_patches(
        prepare_image(frame.image, frame.reference, network.image_content, frame.grasp_range),
        params.shorter_side_px or network.side,
    )
    rest = physical.depth_mm + physical.indentation_mm
    kind = str(network.answer) if params.output_kind == "as trained" else params.output_kind
    output, contact_mask = _run_network(network, image, physical.contact.shape, kind)
    rows, cols = image.shape[:2]
    patches = rows * cols // PATCH_PX**2
    notes = [f"Depth Anything V2 saw {rows}x{cols} pixels, {patches} patches"]
    if kind == "metric":
        indentation = (
            params.largest_mm or network.largest_mm or source.limits.indentation_max_mm
        ) * output
    elif kind == "distance":
        distance_mm = (params.largest_mm or network.largest_mm or _USUAL_DISTANCE_MM) * output
        if not (params.largest_mm or network.largest_mm):
            text = (
                f"the weights do not state their largest distance, {_USUAL_DISTANCE_MM:g} mm "
                "is assumed: depths may be"
            )
            notes.append(
                StageWarning(
                    f"{text} off by a factor; write largest_mm into a TOML next to the weights"
                )
            )
        indentation = _convert_distance(distance_mm, rest, source.limits.indentation_max_mm, notes)
    else:
        indentation = _fit_to_physical(output, physical.indentation_mm, notes)
    indentation = indentation.astype(np.float32)
    least = source.limits.contact_min_mm
    contact = indentation > least if contact_mask is None else contact_mask
    contact &= np.isfinite(physical.depth_mm)
    if contact_mask is None:
        notes.append(
            f"these weights predict no contact: it is where the indentation exceeds {least:g} mm"
        )
    return replace(
        physical,
        indentation_mm=freeze(indentation),
        depth_mm=freeze((rest - indentation).astype(np.float32)),
        contact=freeze(contact),
        notes=(*notes, *physical.notes),
        error=None,
    )


def _run_network(
    network: Any, image: Floats, shape: tuple[int, ...], kind: str
) -> tuple[Floats, Mask | None]:
    """The network's depth and contact on the frame's pixels."""
    import torch

    with reproducible_inference():
        shown = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]
        output, contact = network(shown, None, kind)

    def resample_to_frame(field: Any) -> Floats:
        # As published, corners are aligned.
        return torch.nn.functional.interpolate(
            field[:, None], shape, mode="bilinear", align_corners=True
        )[0, 0].numpy()

    return resample_to_frame(output), None if contact is None else resample_to_frame(
        torch.sigmoid(contact)
    ) > 0.5


def _fit_to_physical(output: Floats, physical_mm: Floats, notes: list[str]) -> Floats:
    """A relative output, scaled and shifted to the least-squares fit to the physical estimate."""
    known = np.isfinite(physical_mm)
    scale = 0.0
    shift = 0.0
    if known.any() and float(np.ptp(output[known])) > 0:
        scale, shift = np.polyfit(
            output[known].astype(np.float64), physical_mm[known].astype(np.float64), 1
        )
    text = (
        "the output has no unit: it is fitted to the physical estimate, and its depths are "
        "only as good as that"
    )
    notes.append(StageWarning(text))
    if scale <= 0:
        text = (
            "the output decreases where physics increases, so it is ignored; give weights "
            "that predict metric depth"
        )
        notes.append(StageWarning(text))
        scale = 0.0
        shift = 0.0
    return (scale * output + shift).astype(np.float32)


def _convert_distance(
    distance_mm: Floats, rest_mm: Floats, most_mm: float, notes: list[str]
) -> Floats:
    """Indentation of a surface at this distance from the camera: rest - distance where that is 0 to
    `most_mm`, else 0.

    The lab's truth is the object alone: where there is none it is 0 m, and beyond the membrane
    nothing is touched.
    """
    indentation = rest_mm - distance_mm
    is_touched = (indentation > 0.0) & (indentation <= most_mm)
    if not is_touched.any():
        text = (
            "no distance lies within the membrane's reach, so nothing is touched; check "
            "largest_mm of the weights"
        )
        notes.append(StageWarning(text))
    return np.where(is_touched | np.isnan(indentation), indentation, 0.0).astype(np.float32)
