"""Preloads what the first depth needs while no recording is open, and what sampling needs once a
frame is shown.
"""

from collections.abc import Iterable

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import Session
from app.window.jobs import LatestJob
from pipeline.core.progress import Progress
from pipeline.stages.networks import network_factory
from pipeline.stages.networks.onnx_predictor import FirstPassPredictor
from pipeline.stages.networks.weights import Weights
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 700  # the window and its 3D views come first
_SAMPLER_DELAY_MS = 1500  # after a frame; browsing comes first


class PreloadController(Feature):
    """Loads packages and kernels on a thread of its own.

    Stops when a recording opens, which loads the same.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self.job = LatestJob("preload", self)
        self.start_timer = make_single_shot_timer(
            self, _DELAY_MS, lambda: self.job.submit(preload_depth)
        )
        self.sampler_timer = make_single_shot_timer(self, _SAMPLER_DELAY_MS, self._preload_samplers)
        controller.frame_shown.connect(self._preload_samplers_soon)
        controller.session_shown.connect(self._stop)
        controller.closing.connect(self.job.close)
        if controller.session.recording is None:
            self.start_timer.start()

    def _stop(self, session: Session) -> None:
        if session.recording is not None:
            self.start_timer.stop()
            self.job.cancel()

    def _preload_samplers_soon(self, _: int) -> None:
        self.sampler_timer.start()

    def _preload_samplers(self) -> None:
        opened = self._controller.views.translation
        if opened is not None and self._controller.is_idle and not self._window.timeline.is_playing:
            self.job.submit(lambda _: preload_samplers(opened.weights.values()))


def preload_samplers(weights: Iterable[object]) -> None:
    """Load torch and the networks whose first pass needed neither, before a slider asks for more
    steps.
    """
    for one in weights:
        if isinstance(one, Weights) and isinstance(
            predictor := network_factory.load_predictor(one), FirstPassPredictor
        ):
            predictor.load_network()


def preload_depth(report: Progress) -> None:
    """Estimate the depth of a synthetic touch, to load packages and compile kernels. Raises
    Cancelled.
    """
    import numpy as np

    from pipeline.core.arrays import freeze
    from pipeline.core.graph import Graph
    from pipeline.core.values.frames import TactileFrame
    from pipeline.physics import optics
    from pipeline.sensors.spec import load_sensor
    from pipeline.stages.depth.stage import PHYSICS

    source = load_sensor("gelslim")
    reference, (rows, cols) = optics.render_reference(source), source.camera.shape
    y, x = np.mgrid[:rows, :cols].astype(np.float32) * source.pixel_mm
    centre_mm = 0.5 * source.pixel_mm * np.array((rows, cols), np.float32)
    dent = np.maximum(0.6 - ((y - centre_mm[0]) ** 2 + (x - centre_mm[1]) ** 2) / 12.0, 0.0)
    image = optics.render(source, dent.astype(np.float32), seed=1)
    frame = TactileFrame(sensor=source.name, image=freeze(image), reference=reference)
    Graph((PHYSICS,)).evaluate(
        (PHYSICS.stage,), {"frame": frame, "source": source, "calibration": None}, {}, report
    )
