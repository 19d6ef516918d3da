"""What the encoder that sets of touches are compared by sees in one touch.

The encoder is the network that tells an object's pose from a sensor's own touches: what it looks at is what matters to
those who use a touch. It comes with the project; its weights are named by their digest in every report. A sensor's own
encoder stays what it is while pose networks are taught on, so that distances of any two days compare.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.networks import weights_registry
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec

_TASK = "touch_pose"


def load_encoder_weights(target: SensorSpec) -> Weights | NoWeights:
    """The encoder of a sensor's touches, or why there is none."""
    own = weights_registry.load_for_task(_TASK, f"encoder_{target.name}", None)
    return own if isinstance(own, Weights) else weights_registry.load_for_task(_TASK, f"pose_{target.name}", None)


def encode_change(target: SensorSpec, changed: Floats) -> Floats | None:
    """What it sees (features,) in a change (rows, cols, channels) of a sensor; None where there is no encoder."""
    known = load_encoder_weights(target)
    return None if isinstance(known, NoWeights) else _seen(known, target, changed)


def _seen(known: Weights, target: SensorSpec, changed: Floats) -> Floats:
    import torch

    from pipeline.networks.network_factory import load_network
    from pipeline.networks.square_images import normalise, resize_to_square

    encoder: Any = load_network(known)
    with torch.inference_mode():
        picture = torch.from_numpy(np.array(normalise(resize_to_square(changed), target.kind))[None])
        return freeze(encoder.features(picture)[0].numpy().astype(np.float32))
