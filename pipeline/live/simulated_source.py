"""Live source: a simulated sensor in which an object is pressed, dragged and turned."""

import time

import numpy as np

from pipeline.base.errors import SettingProblem
from pipeline.geometry.meshes import Mesh
from pipeline.geometry.symmetry import Symmetry
from pipeline.live.source import LiveFrame
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import datasets
from pipeline.simulation.datasets import SimulationPlan
from pipeline.simulation.press import render_sensor_image
from pipeline.values.frames import TactileFrame, Truth

FRAMES_PER_CYCLE = 64  # of press, slide, twist, release; computed in the first cycle, then repeated with new noise
RATE_RANGE_HZ = (0.5, 120.0)
_MAX_WAIT_S = 0.2  # of one `read`


class SimulatedSource:
    """A simulated sensor with a fixed frame rate.

    The first cycle may be slower, since each frame is computed when due. Later a slow reader loses frames.
    """

    def __init__(self, *, sensor: str = "gelslim", tool: str = "sphere", rate_hz: float = 15.0, seed: int = 0) -> None:
        """Raises SettingProblem for an unknown sensor or object, or a rate out of range."""
        if not RATE_RANGE_HZ[0] <= rate_hz <= RATE_RANGE_HZ[1]:
            raise SettingProblem(
                f"the rate must lie within {RATE_RANGE_HZ[0]:g} and {RATE_RANGE_HZ[1]:g} Hz, got {rate_hz:g}"
            )
        like = SimulationPlan(
            sensors=(sensor,), object_source=tool, n_poses=FRAMES_PER_CYCLE, seed=seed, sequence="all"
        )
        self._plan = datasets.make_plans((tool,), like)[0]
        self._spec, self.rate_hz = load_sensor(sensor), rate_hz
        self._frames: dict[int, tuple[TactileFrame, Truth | None]] = {}
        self._noise = np.random.default_rng(seed)
        self._due_s, self._number = 0.0, 0

    @property
    def title(self) -> str:
        """Name for people."""
        return f"simulated {self._spec.title}, {self._plan.object_name}"

    @property
    def sensor(self) -> str:
        """Name of its description."""
        return self._spec.name

    @property
    def touching_object(self) -> tuple[Mesh, Symmetry | None]:
        """Mesh and symmetry of the object that touches it."""
        return datasets.load_object_mesh(self._plan), datasets.load_object_symmetry(self._plan)

    def open(self) -> None:
        """Begin a cycle with the object clear of the sensor."""
        self._get_frame(0)  # compile and load before time counts
        self._due_s, self._number = time.monotonic(), 0

    def read(self) -> LiveFrame | None:
        """The next frame of the cycle when due, else None."""
        wait_s = self._due_s - time.monotonic()
        if wait_s > 0:
            time.sleep(min(wait_s, _MAX_WAIT_S))
            if wait_s > _MAX_WAIT_S:
                return None
        if self._number % FRAMES_PER_CYCLE not in self._frames:
            self._get_frame(self._number % FRAMES_PER_CYCLE)
            self._due_s = time.monotonic()
        missed = max(0, int((time.monotonic() - self._due_s) * self.rate_hz))
        number = self._number + missed
        frame, truth = self._get_frame(number % FRAMES_PER_CYCLE)
        self._number, self._due_s = number + 1, self._due_s + (missed + 1) / self.rate_hz
        image = frame.image if truth is None else self._render_image(truth)
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=number, truth=truth)

    def close(self) -> None:
        """Nothing to release."""

    def _get_frame(self, index: int) -> tuple[TactileFrame, Truth | None]:
        if index not in self._frames:
            self._frames[index] = datasets.simulate_moment(self._plan, index).frames[0]
        return self._frames[index]

    def _render_image(self, truth: Truth) -> np.ndarray:
        """The image of the same touch with new noise."""
        assert truth.indentation_mm is not None
        depth = self._spec.rest_depth_mm - truth.indentation_mm.astype(np.float64)
        return render_sensor_image(self._spec, truth.indentation_mm, depth, int(self._noise.integers(1 << 31)))
