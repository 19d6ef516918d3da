"""Depth by Depth Anything V2 on a user's weights: what the paper reads a touch with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.params import setting
from pipeline.base.progress import Progress
from pipeline.base.stage_warnings import StageWarning
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.graph import Skipped
from pipeline.networks import weights_registry
from pipeline.networks.depth_anything_files import read_weights
from pipeline.networks.depth_anything_input import PATCH_PX, prepare_image, resize_to_patches
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap

OutputKind = Literal["as taught", "metric", "relative"]
_MARGIN = 2  # patches around the contact's box
_NONE = NoWeights(
    why="Depth Anything V2 does not come along; give its weights as --weights FILE, such as depth_anything_v2_vits.pth"
)
PatchWindow = tuple[int, int, int, int]  # top, left, rows, cols, in patches


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthAnythingParams:
    """How the network is asked."""

    shorter_side_px: int = setting(0, "Shorter side", unit="px", low=0, high=1400, step=14,
                        help="of the picture that the network sees; 0 = as it was taught",
                        source="Yang et al. 2024: 518 px, in patches of 14")  # fmt: skip
    max_indentation_mm: float = setting(
        0.0, "Largest indentation", unit="mm", low=0.0, high=100.0, step=0.1,
        help="what its answer 1 stands for; 0 = as the weights say, or else the sensor's own limit",
        source="Yang et al. 2024, metric head: a sigmoid times the largest depth",
    )  # fmt: skip
    output_kind: OutputKind = setting(
        "as taught", "Answer", choices=OutputKind,
        help="metric: a share of the largest indentation; relative: of no unit, brought to the physical estimate",
        source="Yang et al. 2024, both heads; relative depth up to scale and shift: Ranftl et al. 2022",
    )  # fmt: skip
    crop_to_contact: bool = setting(
        False, "Contact's box alone",
        help="quicker by the share of the patches; not exact, as every patch looks at all others",
        source="our own; attention over patches: Dosovitskiy et al. 2021",
    )  # fmt: skip


def select_weights(_source: SensorSpec, _target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The user's weights; none come along."""
    return _NONE if file is None else weights_registry.load_file(file, read_weights)


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: Any,
    params: DepthAnythingParams,
    progress: Progress,
) -> DepthMap | Skipped:
    """Indentation, depth and contact of a frame as the network tells them, on the frame's own grid.

    The membrane at rest comes from the physical reading, and so does the scale of an answer without a unit.
    Raises what that reading does.
    """
    still = photometric.skip_without_contact(frame, source, calibration, photometric.DepthParams())
    if still is not None:
        return Skipped(output=still, reason=still.notes[0])
    physical = photometric.estimate_depth(frame, source, calibration, photometric.DepthParams(), progress)
    progress.step(0.5, "asking the network")
    assert frame.reference is not None  # the physical reading has it
    picture = resize_to_patches(
        prepare_image(frame.image, frame.reference, network.image_content), params.shorter_side_px or network.side
    )
    shape = (picture.shape[0] // PATCH_PX, picture.shape[1] // PATCH_PX)
    window = _box(physical.contact, shape) if params.crop_to_contact else (0, 0, *shape)
    sense = str(network.answer) if params.output_kind == "as taught" else params.output_kind
    answer, touching = _asked(network, picture, window, physical.contact.shape, sense)
    notes = [_told(window, shape)]
    if sense == "metric":
        largest_mm = params.max_indentation_mm or network.largest_mm or source.limits.indentation_max_mm
        indentation = largest_mm * answer
    else:
        indentation = _scaled(answer, physical.indentation_mm, notes)
    inside = _seen(window, shape, physical.contact.shape)
    indentation = np.where(inside, indentation, 0.0).astype(np.float32)
    least = source.limits.contact_min_mm
    contact = (indentation > least if touching is None else touching) & inside & np.isfinite(physical.depth_mm)
    if touching is None:
        notes.append(f"these weights tell no contact: it is where the indentation exceeds {least:g} mm")
    rest = physical.depth_mm + physical.indentation_mm
    return replace(
        physical, indentation_mm=freeze(indentation), depth_mm=freeze((rest - indentation).astype(np.float32)),
        contact=freeze(contact), notes=(*notes, *physical.notes), error=None,
    )  # fmt: skip


def _asked(
    network: Any, picture: Floats, window: PatchWindow, shape: tuple[int, ...], sense: str
) -> tuple[Floats, Mask | None]:
    """The network's two answers brought back to the frame's own grid; outside the window they mean nothing."""
    import torch

    top, left, rows, cols = window
    part = picture[top * PATCH_PX : (top + rows) * PATCH_PX, left * PATCH_PX : (left + cols) * PATCH_PX]
    whole = (top, left, picture.shape[0] // PATCH_PX, picture.shape[1] // PATCH_PX)
    with torch.inference_mode():
        shown = torch.from_numpy(np.ascontiguousarray(part.transpose(2, 0, 1)))[None]
        answer, contact = network(shown, whole, sense)

    def resample_to_frame(field: Any) -> Floats:
        import cv2

        filled = np.zeros(picture.shape[:2], np.float32)
        filled[top * PATCH_PX : (top + rows) * PATCH_PX, left * PATCH_PX : (left + cols) * PATCH_PX] = field[0].numpy()
        size = (shape[1], shape[0])
        return np.asarray(cv2.resize(filled, size, interpolation=cv2.INTER_LINEAR), np.float32)

    return resample_to_frame(answer), None if contact is None else resample_to_frame(torch.sigmoid(contact)) > 0.5


def _box(contact: Mask, shape: tuple[int, int]) -> PatchWindow:
    """The patches that hold the contact and some around it; all of them where there is none."""
    rows, cols = np.nonzero(contact)
    if not rows.size:
        return (0, 0, *shape)
    ends: list[tuple[int, int]] = []
    for places, n_px, n in ((rows, contact.shape[0], shape[0]), (cols, contact.shape[1], shape[1])):
        first, last = (int(place) * n / n_px for place in (places.min(), places.max() + 1))
        ends.append((max(0, math.floor(first) - _MARGIN), min(n, math.ceil(last) + _MARGIN)))
    (top, bottom), (left, right) = ends
    return top, left, bottom - top, right - left


def _seen(window: PatchWindow, shape: tuple[int, int], size: tuple[int, ...]) -> Mask:
    """The frame's pixels that lie in the window."""
    top, left, rows, cols = window
    row, col = (np.arange(n_px) * n // n_px for n_px, n in zip(size, shape, strict=True))
    return ((row >= top) & (row < top + rows))[:, None] & ((col >= left) & (col < left + cols))[None, :]


def _scaled(answer: Floats, physical_mm: Floats, notes: list[str]) -> Floats:
    """An answer without a unit, stretched and shifted to lie as near as it can to the physical estimate."""
    known = np.isfinite(physical_mm)
    stretch, shift = 0.0, 0.0
    if known.any() and float(np.ptp(answer[known])) > 0:
        stretch, shift = np.polyfit(answer[known].astype(np.float64), physical_mm[known].astype(np.float64), 1)
    told = "the network's answer has no unit: it is brought to the physical estimate by a stretch and a shift"
    notes.append(StageWarning(told))
    if stretch <= 0:
        told = "it runs against that estimate, so that nothing of it is left; give weights of a metric depth"
        notes.append(StageWarning(told))
        stretch, shift = 0.0, 0.0
    return (stretch * answer + shift).astype(np.float32)


def _told(window: PatchWindow, shape: tuple[int, int]) -> str:
    rows, cols = (n * PATCH_PX for n in shape)
    told = f"Depth Anything V2 saw {rows}x{cols} pixels, {window[2] * window[3]} patches"
    if window[2:] != shape:
        told += f" of {shape[0] * shape[1]}: the contact's box alone, which is not exactly what it would tell of all"
    return told
