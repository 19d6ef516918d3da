"""Images that sensors record of a membrane, for each kind of sensor."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import SettingProblem
from pipeline.physics import bubble, optics
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable
from pipeline.sensors.spec import SensorSpec

# (sensor, indentation_mm, depth_mm, seed, shear_mm) of `render_sensor_image` -> image
RenderImage = Callable[
    [SensorSpec, Floats, NDArray[Any], int | None, Floats | None], Image | Floats
]


def render_reference(sensor: SensorSpec) -> NDArray[Any]:
    """The image of a sensor without contact and noise: RGB (rows, cols, 3) uint8, or depth
    (rows, cols) mm.
    """
    if sensor.optics is not None:
        return optics.render_reference(sensor)
    return render_sensor_image(
        sensor, np.zeros(sensor.camera.shape, np.float32), sensor.rest_depth_mm, None
    )


def render_sensor_image(
    sensor: SensorSpec,
    indentation_mm: Floats,
    depth_mm: NDArray[Any],
    seed: int | None,
    *,
    shear_mm: Floats | None = None,
) -> Image | Floats:
    """The frame of a membrane at `depth_mm`, `indentation_mm` from rest, with noise unless `seed`
    is None.

    Raises SettingProblem for a kind of sensor whose images are not simulated.
    """
    render = IMAGE_RENDERERS.get(sensor.sensor_kind)
    if render is None:
        raise SettingProblem(
            f"images of sensors of kind {sensor.kind!r} such as {sensor.name} cannot be simulated"
        )
    return render(sensor, indentation_mm, depth_mm, seed, shear_mm)


def _render_gel_image(
    sensor: SensorSpec,
    indentation_mm: Floats,
    _depth_mm: NDArray[Any],
    seed: int | None,
    shear_mm: Floats | None,
) -> Image:
    return optics.render(sensor, indentation_mm, seed=seed, shear_mm=shear_mm)


def _render_bubble_image(
    sensor: SensorSpec,
    _indentation_mm: Floats,
    depth_mm: NDArray[Any],
    seed: int | None,
    _shear_mm: Floats | None,
) -> Floats:
    return bubble.simulate_depth_frame(sensor, depth_mm, seed)


IMAGE_RENDERERS: KindTable[RenderImage] = KindTable(
    {GelSensor: _render_gel_image, BubbleSensor: _render_bubble_image}
)
