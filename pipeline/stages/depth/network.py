"""Depth by network: selects the weights and the method for the kind of sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.calibration_table import Calibration
from pipeline.networks import weights_registry
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_network, gel_network, photometric
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap

_TASKS = {"gel": "gel_instances", "bubble": "bubble_depth"}  # kind of sensor -> task of the weights


def select_weights(source: SensorSpec, _target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights for this source: one network for all gels, one for all bubbles."""
    task = _TASKS.get(source.kind)
    if task is None:
        return NoWeights(why=f"no network estimates depth of sensors of kind {source.kind!r}")
    return weights_registry.load_for_task(task, task, file)


def skip_without_contact(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    _weights: Weights | NoWeights,
    params: NetworkParams,
) -> DepthMap | None:
    """The exact depth of a frame without contact; None where something may touch."""
    return photometric.skip_without_contact(frame, source, calibration, params)


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: Any,
    params: NetworkParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation, depth and contact of a frame; raises ShapeError for an invalid frame.

    `network`: `network_factory.load_predictor` of the weights for this kind of sensor.
    """
    if source.kind == "gel":
        return gel_network.estimate_depth(frame, source, calibration, network, params, progress)
    photometric.check_frame(frame, source)  # a draft is the full result: fewer pixels are no faster here
    seen_by = source if frame.camera is None else source.with_camera(frame.camera)
    least_mm = params.contact_limit * source.limits.contact_min_mm
    depth = bubble_network.estimate_depth(frame, seen_by, network, certainty=params.certainty, least_mm=least_mm)
    return replace(depth, error=photometric.make_bubble_error(source))
