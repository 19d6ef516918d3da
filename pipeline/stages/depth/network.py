"""Depth by network: which one reads a sensor, and where its weights come from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.lookup import Calibration
from pipeline.networks import shelf
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_network, gel_network, stage
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap


def weights(source: SensorSpec, _target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights that read this source: one network for all gels, one for all bubbles."""
    if source.kind == "gel":
        return shelf.for_task(("gel_units", "gel_depth", "ball_depth"), "gel_units", file)
    return shelf.for_task("bubble_reading", "bubble_depth", file)


def untouched(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    _weights: Weights | NoWeights,
    params: NetworkParams,
) -> DepthMap | None:
    """The exact answer for a frame in which nothing touches; None when something may."""
    return stage.untouched(frame, source, calibration, params)


def depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: Any,
    params: NetworkParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation, depth and contact of a frame as a network reads it; raises ShapeError for what is no frame.

    `network` is what `building.ready` makes of the weights for this kind of sensor.
    """
    if source.kind == "gel":
        return gel_network.depth(frame, source, calibration, network, params, progress)
    stage.checked(frame, source)  # fewer pixels are no quicker here: a draft is the answer
    seen_by = source if frame.camera is None else source.seen_through(frame.camera)
    least_mm = params.contact_limit * source.limits.contact_min_mm
    found = bubble_network.depth(frame, seen_by, network, certainty=params.certainty, least_mm=least_mm)
    return replace(found, error=stage.measured_error(source))
