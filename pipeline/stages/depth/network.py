"""Depth by network: selects the weights and the method for the kind of sensor."""

from pathlib import Path
from typing import Any

from pipeline.base.entry_points import load_reference
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.calibration_table import Calibration
from pipeline.networks import weights_registry
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap


def select_weights(source: SensorSpec, _target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights for this source: one network for all gels, one for all bubbles."""
    task = source.sensor_kind.depth_task
    if not task:
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
    return load_reference(source.sensor_kind.depth_network)(frame, source, calibration, network, params, progress)
