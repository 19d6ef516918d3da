"""The light of a gel without contact, computed from its description."""

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.memo import memoise
from pipeline.geometry.camera import Camera
from pipeline.sensors.parts import Optics


@memoise(32)
def compute_reference_light(camera: Camera, optics: Optics) -> Floats:
    """Grey levels (rows, cols, 3) float32 of a gel without contact, before markers and lens blur."""
    x = ((np.arange(camera.cols) + 0.5) / camera.cols * 2 - 1)[None, :]
    y = ((np.arange(camera.rows) + 0.5) / camera.rows * 2 - 1)[:, None]
    light = np.empty((*camera.shape, 3))
    light[:] = optics.base_rgb
    for glow in optics.glows:
        lobe = np.exp(-(((x - glow.x) / glow.width) ** 2) - ((y - glow.y) / glow.height) ** 2)
        light += lobe[..., None] * np.array(glow.rgb)
    lens = 1.0 - optics.vignette * ((x * x + y * y) / 2) ** 2
    return freeze((light * lens[..., None]).astype(np.float32))


@memoise(32)
def compute_mean_reference_light(camera: Camera, optics: Optics) -> Floats:
    """Mean of `compute_reference_light` of each colour (3,), grey levels."""
    return freeze(compute_reference_light(camera, optics).reshape(-1, 3).mean(axis=0))
