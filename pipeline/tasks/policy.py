"""The cloned controller of a task: a small network that commands from the image of the sensor it was trained on."""

from typing import Any

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.networks.network_factory import load_predictor
from pipeline.networks.weights_registry import load_for_task

POLICY_TASK = "cloned_policy"  # of `pipeline.training`
_ROWS, _COLS = 48, 64  # of the network's input


def shrink_image(image: np.ndarray[Any, Any]) -> Floats:
    """The network's input (3, 48, 64) in shares of full brightness from an image (rows, cols, 3) of any size."""
    import cv2

    small = cv2.resize(image, (_COLS, _ROWS), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small.transpose(2, 0, 1)).astype(np.float32) / np.float32(255.0)


def command_from_image(weights_name: str, image: np.ndarray[Any, Any]) -> Doubles:
    """The command of the shipped policy of this name for an image; raises ModelMissing without its weights."""
    network: Any = load_predictor(load_for_task(POLICY_TASK, weights_name, None))
    return np.asarray(network(shrink_image(image))[0], np.float64)
