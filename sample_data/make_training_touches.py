"""Describe the touches that the generating networks were trained on:
`weights/training_touches_SENSOR.npz`.

    python sample_data/make_training_touches.py [N_TOUCHES]

The touches are those of `pipeline.lab.training.simulated_touches`, first press seed, as the recipes
t2d2_* train on them; the numbers are those of `pipeline.translation.round_trip`. The window and
`translate` rank frames by the distance from them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.core.files import write_arrays
from pipeline.lab.training.simulated_touches import simulate_target_touch
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.weights_registry import WEIGHTS_FOLDER
from pipeline.stages.touch.t2d2 import make_working_sensor
from pipeline.translation.round_trip import describe_touch

SENSORS = ("soft_bubble", "gelslim")
N_TOUCHES = 300
PRESS_SEED = 1


def main() -> None:
    """Simulate the touches and write their features."""
    n_touches = int(sys.argv[1]) if len(sys.argv) > 1 else N_TOUCHES
    for name in SENSORS:
        sensor = make_working_sensor(load_sensor(name))
        touches = (
            simulate_target_touch(name, "training", PRESS_SEED, index) for index in range(n_touches)
        )
        described = [
            describe_touch(t.observed, t.observed_mm, sensor.pixel_mm)
            for t in touches
            if t is not None
        ]
        features = np.array([numbers for numbers in described if numbers is not None], np.float32)
        write_arrays(WEIGHTS_FOLDER / f"training_touches_{name}.npz", {"features": features})


if __name__ == "__main__":
    main()
