"""Preloads what the first depth needs while no recording is open, and what sampling needs once a
frame is shown.
"""

from collections.abc import Iterable

from app.document.background_controller import BackgroundController
from app.document.session_controller import SessionController
from app.session.sample import SAMPLE_RECORDING
from pipeline.core.progress import Progress
from pipeline.stages.networks import network_factory
from pipeline.stages.networks.onnx_predictor import FirstPassPredictor
from pipeline.stages.networks.weights import Weights
from widgets.style.styling import make_single_shot_timer

_TOUCHING = 5  # frame of the sample
_DELAY_MS = 700  # the window and its 3D views come first
_SAMPLER_DELAY_MS = 1500  # after a frame; browsing comes first


class PreloadController(BackgroundController):
    """Loads packages and kernels on a thread of its own.

    Stops when a recording opens, which loads the same.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__("preload", controller)
        self.start_timer = make_single_shot_timer(
            self, _DELAY_MS, lambda: self.job.submit(preload_depth)
        )
        self.sampler_timer = make_single_shot_timer(self, _SAMPLER_DELAY_MS, self._preload_samplers)
        if controller.session.recording is None and SAMPLE_RECORDING.exists():
            self.start_timer.start()

    def show_session(self) -> None:
        """Stop as a recording opens."""
        if self._session.recording is not None:
            self.start_timer.stop()
            self.job.cancel()

    def show_frame(self) -> None:
        """Preload what sampling needs, once browsing has ended."""
        self.sampler_timer.start()

    def _preload_samplers(self) -> None:
        opened = self._translation
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
    """Estimate the depth of a touch of the sample, to load packages and compile kernels.

    Raises Cancelled.
    """
    from pipeline.translation.translate import Request, open_translation

    with open_translation(Request(recording=SAMPLE_RECORDING, target="soft_bubble")) as opened:
        opened.evaluate(_TOUCHING, ["depth"], report)
