"""Loads packages and compiled code ahead: for the first depth, and for the first sample of a touch."""

from collections.abc import Iterable

from pipeline.base.progress import Progress
from pipeline.networks import network_factory
from pipeline.networks.first_pass import FirstPassPredictor
from pipeline.networks.weights import Weights


def preload_samplers(weights: Iterable[object]) -> None:
    """Load torch and the networks whose first pass needed neither, before a slider asks for more steps."""
    for one in weights:
        if isinstance(one, Weights) and isinstance(
            predictor := network_factory.load_predictor(one), FirstPassPredictor
        ):
            predictor.load_network()


def preload_depth(report: Progress) -> None:
    """Estimate the depth of a synthetic touch, to load packages and compile kernels. Raises Cancelled."""
    import numpy as np

    from pipeline.base.arrays import freeze
    from pipeline.engine.graph import Graph
    from pipeline.physics import optics
    from pipeline.sensors.spec import load_sensor
    from pipeline.stages.depth.stage import PHYSICS
    from pipeline.values.frames import TactileFrame

    source = load_sensor("gelslim")
    reference, (rows, cols) = optics.render_reference(source), source.camera.shape
    y, x = np.mgrid[:rows, :cols].astype(np.float32) * source.pixel_mm
    centre_mm = 0.5 * source.pixel_mm * np.array((rows, cols), np.float32)
    dent = np.maximum(0.6 - ((y - centre_mm[0]) ** 2 + (x - centre_mm[1]) ** 2) / 12.0, 0.0)
    image = optics.render(source, dent.astype(np.float32), seed=1)
    frame = TactileFrame(sensor=source.name, image=freeze(image), reference=reference)
    Graph((PHYSICS,)).evaluate((PHYSICS.stage,), {"frame": frame, "source": source, "calibration": None}, {}, report)
