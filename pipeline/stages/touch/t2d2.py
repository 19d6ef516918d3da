"""T2D2, compact: the physical render of the target depth, plus the residual that a denoiser
samples.

What a bubble feels outside the source's contact cannot be computed by physics; it needs knowledge
of objects. The network is trained on touches of the target sensor alone, without sensor pairs. With
no step the result is the physical render, to the byte.

Input of the T2D2 networks, for training and inference.

The compact denoiser gets physical render, contact, view, and fine relief on the working grid;
latent diffusion gets the target depth, its contact mask and the source's view as a square.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.digests import compute_cached_digest
from pipeline.core.frozen import frozen
from pipeline.core.graph import Fallback
from pipeline.core.memo import Memo
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.results import DepthMap, GeneratedTouch, SealedMembrane, TargetDepth
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.onnx_predictor import ResidualNetwork
from pipeline.stages.networks.touch_formats import (
    answer_for_known_kinds,
    get_touch_format,
    resize_to_square,
)
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.touch import physical_render
from pipeline.stages.touch.physical_render import PhysicalRenderParams
from pipeline.stages.touch.residual_diffusion import (
    NO_PRIOR_CONTACT,
    NO_STEPS,
    DiffusionParams,
    read_error_calibration,
    render_correction,
    report_change,
    resample_to_grid,
    sample_residual,
    shrink_to_prior,
)

MAX_PIXEL_RATIO = 1.25  # allowed ratio to the trained pixel size
_HALF = 0.5


@frozen
class T2D2Params(DiffusionParams):
    """Sampling settings, and how far an uncertain mean is shrunk toward the physical render."""

    confidence_weighting: float = setting(
        1.0,
        "Confidence weighting",
        unit="share",
        low=0.0,
        high=1.0,
        step=0.1,
        help="one step only: 1 shrinks uncertain corrections toward physics; 0 takes the network "
        "as it is",
        source="Wiener gain m^2 / (m^2 + s^2) of mean m and expected error s",
    )


@answer_for_known_kinds
def select_weights(
    source: SensorSpec, target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The weights of a target sensor kind.

    From a bubble to a gel physics is as near as a compact network.
    """
    if file is None and source.sensor_kind.is_depth and not target.sensor_kind.is_depth:
        return NoWeights(
            why="from a bubble to a gel a network changes less than the bubble's own error"
        )
    shipped = get_touch_format(target.kind).t2d2_weights
    if file is None and not has_trained_pixel_size(target):
        return NoWeights(why=explain_misfit(target))
    return weights_registry.load_for_task("touch_residual", shipped, file, target_kind=target.kind)


def has_trained_pixel_size(target: SensorSpec) -> bool:
    """Whether the pixel size of the working grid is close to that of the training data."""
    ratio = make_working_sensor(target).pixel_mm / get_touch_format(target.kind).trained_pixel_mm
    return 1 / MAX_PIXEL_RATIO < ratio < MAX_PIXEL_RATIO


def explain_misfit(target: SensorSpec) -> str:
    """Why the shipped weights do not fit a target."""
    trained_mm = get_touch_format(target.kind).trained_pixel_mm
    pixel_mm = make_working_sensor(target).pixel_mm
    return f"pixels of {pixel_mm:.3g} mm differ from the {trained_mm:g} mm of the training data"


def generate_touch(
    view: TargetDepth,
    target: SensorSpec,
    network: ResidualNetwork,
    params: T2D2Params,
    progress: Progress = SILENT,
    *,
    start: SealedMembrane | None = None,
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    """Generate what `target` would record of `view`, a bubble's membrane from a `start` near by.

    Raises ShapeError for a view of another image size.
    """
    rendering = SubProgress(progress, 0.0, 0.3) if params.steps else progress
    physical = _render(
        view,
        target,
        start,
        PhysicalRenderParams(add_noise=params.add_noise, seed=params.seed),
        rendering,
    )
    prior = physical.membrane
    if not params.steps:
        return Fallback(result=physical, reason=NO_STEPS)
    if prior is None or not prior.contact.any():
        return Fallback(result=physical, reason=NO_PRIOR_CONTACT)
    samples_contact = target.sensor_kind.is_depth
    sample = sample_residual(
        network,
        build_condition(view, prior, target),
        params,
        SubProgress(progress, 0.3, 0.7),
        draw_last_noise=samples_contact,
    )
    if samples_contact:  # contact measured by the source gel is certain
        in_contact = np.where(
            resample_to_grid(view.contact, make_working_sensor(target).camera.shape) > _HALF,
            1.0,
            0.0,
        ).astype(np.float32)
        sample = replace(
            sample,
            final=replace(
                sample.final,
                contact_correction=np.maximum(sample.final.contact_correction, in_contact),
            ),
        )
    outside = sample.expected_error_mm[
        resample_to_grid(view.in_view, sample.expected_error_mm.shape) < _HALF
    ]
    error_mm = float((outside if outside.size else sample.expected_error_mm).mean())
    region = "outside the source's view" if outside.size else "in the whole image"
    if params.steps == 1:  # samples are not shrunk
        # Gel contact is better by physics: overlap 0.696 instead of 0.692 on 78 touches outside the
        # tables.
        sample = shrink_to_prior(
            sample,
            view.in_view,
            params.confidence_weighting,
            read_error_calibration(network),
            shrinks_contact=samples_contact,
        )
    note = f"{region} the touch is generated by the network, expected error {error_mm:.2g} mm"
    sample = replace(sample, notes=(*sample.notes, note))
    touch = render_correction(physical, target, sample, params.seed if params.add_noise else None)
    return report_change(touch, physical)


def _render(
    view: TargetDepth,
    target: SensorSpec,
    start: SealedMembrane | None,
    params: PhysicalRenderParams,
    progress: Progress,
) -> GeneratedTouch:
    """The physical render, cached: a dragged slider then costs network passes only."""
    key = (*(compute_cached_digest(value) for value in (view, target, start)), params)
    return _rendered.get_or_make(
        key, lambda: physical_render.render_touch(view, target, params, progress, start=start)
    )


_rendered: Memo[tuple[object, ...], GeneratedTouch] = Memo(1)


def build_condition(view: TargetDepth, physical: DepthMap, target: SensorSpec) -> Floats:
    """(CONDITION_CHANNELS, rows, cols) on the working grid.

    See `depth_condition.build_depth_condition`.
    """
    shape = make_working_sensor(target).camera.shape
    share = resample_to_grid(view.contact, shape)
    indentation_mm = resample_to_grid(
        np.where(view.contact, view.indentation_mm, np.float32(0.0)), shape
    ) / np.maximum(share, 1e-6)
    in_contact = share > _HALF
    return build_depth_condition(
        target.kind,
        np.where(in_contact, indentation_mm, 0.0).astype(np.float32),
        in_contact,
        resample_to_grid(view.in_view, shape) > _HALF,
        resample_to_grid(physical.indentation_mm, shape),
        resample_to_grid(physical.contact, shape) > _HALF,
    )


CONDITION_CHANNELS = 6


def make_working_sensor(target: SensorSpec) -> SensorSpec:
    """The target with the camera of the working grid."""
    factor = get_touch_format(target.kind).grid_factor
    return target if factor == 1 else target.with_camera(target.camera.scale(1.0 / factor))


def build_depth_condition(
    kind: str,
    indentation_mm: Floats,
    contact: Mask,
    in_view: Mask,
    physical_mm: Floats,
    physical_contact: Mask,
) -> Floats:
    """(CONDITION_CHANNELS, rows, cols) float32 for a target of that kind.

    All arguments on the working grid.
    """
    known = get_touch_format(kind)
    deepest = float(indentation_mm[contact].max()) if contact.any() else 0.0
    lowest = np.float32(-known.max_relief_mm)
    relief = np.where(contact, np.clip(indentation_mm - deepest, lowest, 0.0), lowest)
    return freeze(
        np.stack(
            [
                physical_mm / known.indentation_unit_mm,
                np.where(contact, indentation_mm, 0.0) / known.indentation_unit_mm,
                relief / known.relief_unit_mm,
                contact,
                in_view,
                physical_contact,
            ]
        ).astype(np.float32)
    )


def build_depth_square(
    kind: str, indentation_mm: Floats, contact: Mask, in_view: Mask, side: int
) -> Floats:
    """(3, side, side) of the target depth's fields (rows, cols): indentation in contact,
    contact, the source's view.
    """
    indentation = np.where(contact, indentation_mm, np.float32(0.0)) / np.float32(
        get_touch_format(kind).indentation_unit_mm
    )
    return resize_to_square(
        np.stack([indentation, contact, in_view], axis=-1).astype(np.float32), side
    )
