"""Presses as the simulator makes them, of tools that are never drawn for training, on other units of the gels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats
from pipeline.geometry import rigid
from pipeline.physics import optics
from pipeline.sensors.spec import sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import press
from pipeline.simulation.variation import varied
from pipeline.stages.depth import network_input

_SENSORS = ("gelsight_mini", "gelslim", "digit")
_DEPTHS_MM = (0.15, 0.4, 0.8)


def tool(index: int) -> dict[str, NDArray[Any]]:
    """Example `index`: a tool of the group "unseen", pressed somewhere by one of three depths."""
    rng = np.random.default_rng([9, index])
    source = sensor(_SENSORS[index % 3])
    unit, names = varied(source, 5000 + index), shapes.names("unseen")
    thing = shapes.shape(names[(index // 3) % len(names)]).mesh
    while True:
        x, y = rng.uniform(-2.5, 2.5, 2)
        pose = rigid.translation(x, y, 0.0) @ rigid.rotation((0.0, 0.0, rng.uniform(-3.0, 3.0)))
        pose[2, 3] = -_DEPTHS_MM[(index // 9) % 3] - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
        felt = press(thing, pose, unit, seed=index)
        if felt.converged and felt.truth.contact is not None and felt.truth.contact.any():
            break
    assert felt.truth.indentation_mm is not None
    at = network_input.frame(source.camera.shape)
    pictures = at.small(np.asarray(felt.image)), at.small(optics.untouched(unit))

    def field(of: Floats) -> Floats:
        return at.small(of[..., None].repeat(3, axis=2))[..., 0]

    return {
        "fields": network_input.fields(*pictures, network_input.light_of(source)),
        "indentation": field(felt.truth.indentation_mm) / np.float32(source.pixel_mm * at.pixels),
        "contact": (field(felt.truth.contact.astype(np.float32)) > 0.5).astype(np.uint8),
    }
