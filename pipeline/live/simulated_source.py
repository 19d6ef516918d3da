"""A sensor that is always there: an object pressed into it, dragged and turned, by the simulator, at a rate."""

from __future__ import annotations

import time

import numpy as np

from pipeline.base.errors import SettingProblem
from pipeline.geometry.meshes import Mesh
from pipeline.geometry.symmetry import Symmetry
from pipeline.live.source import LiveFrame, LiveSourceLost
from pipeline.sensors.spec import load_sensor as sensor_named
from pipeline.simulation import datasets
from pipeline.simulation.datasets import SimulationPlan
from pipeline.simulation.press import render_sensor_image
from pipeline.values.frames import TactileFrame, Truth

FRAMES_PER_CYCLE = (
    64  # of one round: press, slide, twist, release; worked out in the first round, seen again with new noise
)
RATE_RANGE_HZ = (0.5, 120.0)
_NAP_S = 0.2


class SimulatedSource:
    """The first round may be slower than the rate that is asked for: each of its moments is worked out when it is due.

    After it a reader that is too slow loses readings, as of a camera.
    """

    def __init__(self, *, sensor: str = "gelslim", tool: str = "sphere", rate_hz: float = 15.0, seed: int = 0) -> None:
        """Raises SettingProblem for a sensor, an object or a rate that cannot be."""
        if not RATE_RANGE_HZ[0] <= rate_hz <= RATE_RANGE_HZ[1]:
            raise SettingProblem(
                f"the rate must lie within {RATE_RANGE_HZ[0]:g} and {RATE_RANGE_HZ[1]:g} Hz, got {rate_hz:g}"
            )
        like = SimulationPlan(
            sensors=(sensor,), object_source=tool, n_poses=FRAMES_PER_CYCLE, seed=seed, sequence="all"
        )
        self._plan = datasets.make_plans((tool,), like)[0]
        self._spec, self.rate_hz = sensor_named(sensor), rate_hz
        self._known: dict[int, tuple[TactileFrame, Truth | None]] = {}
        self._noise = np.random.default_rng(seed)
        self._due_s, self._number = 0.0, 0
        self._plugged = True

    @property
    def title(self) -> str:
        """What it is, in words."""
        return f"simulated {self._spec.title}, {self._plan.object_name}"

    @property
    def sensor(self) -> str:
        """Its description's name."""
        return self._spec.name

    @property
    def touching_object(self) -> tuple[Mesh, Symmetry | None]:
        """The object that touches it, and what maps it onto itself."""
        return datasets.load_object_mesh(self._plan), datasets.load_object_symmetry(self._plan)

    def unplug(self) -> None:
        """As a cable that is pulled."""
        self._plugged = False

    def plug(self) -> None:
        """As a cable that is put back."""
        self._plugged = True

    def open(self) -> None:
        """Begin with the object clear of the sensor."""
        if not self._plugged:
            raise LiveSourceLost("the simulated sensor is unplugged; plug it in")
        self._moment(0)  # what is compiled and looked up once is no delay of the sensor
        self._due_s, self._number = time.monotonic(), 0

    def read(self) -> LiveFrame | None:
        """The next moment of the round, when it is due."""
        if not self._plugged:
            raise LiveSourceLost("the simulated sensor was unplugged; plug it in")
        wait_s = self._due_s - time.monotonic()
        if wait_s > 0:
            time.sleep(min(wait_s, _NAP_S))
            if wait_s > _NAP_S:
                return None
        if self._number % FRAMES_PER_CYCLE not in self._known:
            self._moment(self._number % FRAMES_PER_CYCLE)
            self._due_s = time.monotonic()
        missed = max(0, int((time.monotonic() - self._due_s) * self.rate_hz))
        number = self._number + missed
        frame, truth = self._moment(number % FRAMES_PER_CYCLE)
        self._number, self._due_s = number + 1, self._due_s + (missed + 1) / self.rate_hz
        image = frame.image if truth is None else self._taken(truth)
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=number, truth=truth)

    def close(self) -> None:
        """Nothing to let go of."""

    def _moment(self, index: int) -> tuple[TactileFrame, Truth | None]:
        if index not in self._known:
            self._known[index] = datasets.simulate_moment(self._plan, index).frames[0]
        return self._known[index]

    def _taken(self, truth: Truth) -> np.ndarray:
        """The same touch, photographed anew."""
        assert truth.indentation_mm is not None
        depth = self._spec.rest_depth_mm - truth.indentation_mm.astype(np.float64)
        return render_sensor_image(self._spec, truth.indentation_mm, depth, int(self._noise.integers(1 << 31)))
