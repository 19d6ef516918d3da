"""Depth of a gel by the network that reads all gels: no look-up is asked for, and a unit need not be calibrated.

The network looks at 120 x 160 pixels whatever the sensor has (`network_input`), so that its time does not depend on the
picture: a gel's picture is blurred by more than such a pixel. What it tells in pixels becomes mm by the width of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.doubts import AT_BORDER, Doubt
from pipeline.base.memo import Memo
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.lookup import Calibration
from pipeline.engine.digests import content
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import contact, network_input, stage
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import pixel_index
from pipeline.values.results import DepthError, DepthMap

if TYPE_CHECKING:
    from torch import nn

_SPECK_MM2 = 0.15  # smaller contacts are camera noise
_CORRELATION_PX = 8.0  # of the network's pixels: its errors go together over about what it integrates over


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkParams:
    """How the network's answer is taken."""

    certainty: float = setting(
        0.5, "Certainty of contact", low=0.05, high=0.95, step=0.05,
        help="contact is where the network holds it for likelier than this",
    )  # fmt: skip


def depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,  # noqa: ARG001 - a unit that is calibrated is the look-up's
    network: nn.Module,
    params: NetworkParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation, depth and contact of a gel's frame, with the error that the network itself expects.

    Raises ShapeError for a frame that cannot be read.
    """
    progress.step(0.0, "comparing with the untouched frame")
    stage.checked(frame, source)
    seen_by = source if frame.camera is None else source.seen_through(frame.camera)
    at, pixel_mm = network_input.frame(seen_by.camera.shape), 0.0
    pixel_mm = seen_by.pixel_mm * at.pixels
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    fields = network_input.fields(at.small(image), at.small(reference), _light(seen_by))
    progress.step(0.3, "reading")
    surface, likely, spread = _read(network, fields)
    limit = np.float32(math.log(params.certainty / (1.0 - params.certainty)))
    touched = contact.without_specks(at.large(likely) > limit, max(4, round(_SPECK_MM2 / seen_by.pixel_mm**2)))
    notes: list[str] = []
    indentation = np.zeros(seen_by.camera.shape, np.float32)
    error = None
    if touched.any():
        indentation = at.large(surface) * np.float32(pixel_mm)
        notes += _limited(indentation, touched, seen_by)
        error = _error(spread, likely > limit, pixel_mm)
    else:
        notes.append("nothing touches the sensor")
    progress.step(1.0, "depth is ready")
    return DepthMap(
        indentation_mm=freeze(indentation),
        depth_mm=freeze((seen_by.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(touched),
        camera=seen_by.camera,
        source_index=pixel_index(seen_by.camera.shape),
        notes=tuple(notes),
        error=error,
    )


_lights: Memo[str, network_input.Light] = Memo(16)


def _light(sensor: SensorSpec) -> network_input.Light | None:
    if sensor.optics is None:
        return None
    return _lights.of(content(sensor), lambda: network_input.light_of(sensor))


def _read(network: nn.Module, fields: Floats) -> tuple[Floats, Floats, Floats]:
    """(surface in pixels, logit of contact, Laplace scale of the surface in pixels), each (120, 160)."""
    import torch

    with torch.inference_mode():
        reading = network(torch.from_numpy(fields)[None])
    return reading.surface[0].numpy(), reading.contact[0].numpy(), np.exp(reading.log_spread[0].numpy())


def _error(spread_px: Floats, touched: Mask, pixel_mm: float) -> DepthError | None:
    """What the network expects to be off by where it is touched: a Laplace scale b is a deviation of sqrt(2) b."""
    inside = spread_px[touched]
    if not inside.size:
        return None
    rms = math.sqrt(2.0 * float(np.mean(np.square(inside, dtype=np.float64)))) * pixel_mm
    return DepthError(rms_mm=rms, correlation_mm=_CORRELATION_PX * pixel_mm)


def _limited(indentation: Floats, touched: Mask, sensor: SensorSpec) -> list[str]:
    """Cut what is deeper than the sensor, in place; what is to be said of it."""
    notes: list[str] = []
    most = sensor.limits.indentation_max_mm
    beyond = int(np.count_nonzero(indentation > most))
    if beyond:
        notes.append(Doubt(f"{beyond} pixels were deeper than the sensor's {most:g} mm and were cut to that"))
        np.minimum(indentation, np.float32(most), out=indentation)
    if touched[0].any() or touched[-1].any() or touched[:, 0].any() or touched[:, -1].any():
        notes.append(AT_BORDER)
    return notes
