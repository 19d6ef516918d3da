"""Features of a touch, by the encoder that compares sets of touches.

The encoder is the network that estimates an object's pose from a sensor's touches, so its features
are what users of a touch depend on. It is shipped with the project; reports state the digest of its
weights. A sensor's encoder does not change when pose networks are trained further, so that
distances of different days are comparable.
"""

from typing import Any

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import NoWeights, Weights

_TASK = "touch_pose"


def load_encoder_weights(target: SensorSpec) -> Weights | NoWeights:
    """The encoder of a sensor's touches, or the reason that there is none."""
    own = weights_registry.load_for_task(_TASK, f"encoder_{target.name}", None)
    return (
        own
        if isinstance(own, Weights)
        else weights_registry.load_for_task(_TASK, f"pose_{target.name}", None)
    )


def encode_change(target: SensorSpec, change: Floats) -> Floats | None:
    """Features (n,) of a change (rows, cols, channels) of a sensor; None without encoder."""
    known = load_encoder_weights(target)
    if isinstance(known, NoWeights):
        return None
    import torch

    from pipeline.stages.networks.network_factory import load_network
    from pipeline.stages.networks.touch_formats import normalise, resize_to_square

    encoder: Any = load_network(known)
    with torch.inference_mode():
        image = torch.from_numpy(np.array(normalise(resize_to_square(change), target.kind))[None])
        return freeze(encoder.compute_embedding(image)[0].numpy().astype(np.float32))
