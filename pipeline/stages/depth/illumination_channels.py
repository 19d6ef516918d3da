"""What a network that tells the depth of a whole touch is shown besides `network_input`: how bright its light is.

    16-18  change of colour, of 60 grey levels
    19     logarithm of the largest slope that the described lights would make of it, over 0.5
    20-22  by how much the first lamps that physics found are brighter than described, in standard deviations of units
    23     by how much they stand higher, on the mean, in standard deviations
    24     1 where physics has found other lamps, 0 where the described ones will do, less where none explain it
    25-27  which sensor it is of those that were learned from

A bright lamp and a steep surface look alike but for the light's own curvature, for saturation, and for what is known of
a sensor: units differ by a tenth or so (`simulation.variation`).
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.physics import optics
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import adaptive_illumination, gel_network_input
from pipeline.stages.depth.gel_network_input import N_CHANNELS, NetworkInput

N_ALL_CHANNELS = N_CHANNELS + 12
TRAINED_SENSORS = ("gelslim", "digit", "gelsight_mini")
# Without printed markers a GelSlim is lit the same; nothing was learned from it by itself.
_LEARNED_AS = {**{name: name for name in TRAINED_SENSORS}, "gelslim_dotless": "gelslim"}
_GREY, _MOST = 60.0, 4.0
_USUAL_SLOPE = 0.5
_LAMPS, _POWER, _ELEVATION_DEG = 3, 0.15, 3.0  # what units differ by, about
_STEEP, _BRIGHTER, _HIGHER, _FOUND, _SENSOR = (
    N_CHANNELS + 3,
    N_CHANNELS + 4,
    N_CHANNELS + 7,
    N_CHANNELS + 8,
    N_CHANNELS + 9,
)
_NEAR, _FIELD = -1.0, -2.0  # lamps close beside, or none


def explain_exclusion(source: SensorSpec, light: adaptive_illumination.Illumination | None) -> str:
    """Why nothing was learned of such a touch, another sensor or a light that physics cannot explain; "" if it was."""
    if source.name not in _LEARNED_AS:
        return f"the network has not learned from {source.name}: it was not asked, and physics' answer stands"
    if not adaptive_illumination.is_trusted(light):
        return "no usual unit's lamps explain the picture: the network was not asked, and physics' answer stands"
    return ""


def compute_all_channels(
    of: NetworkInput, source: SensorSpec, light: adaptive_illumination.Illumination | None
) -> Floats:
    """All fields (28, 120, 160): those of `network_input` and these."""
    out = np.zeros((N_ALL_CHANNELS, gel_network_input.ROWS, gel_network_input.COLS), np.float32)
    steep = gel_network_input.compute_peak_slope(of)
    out[:N_CHANNELS] = gel_network_input.compute_channels(of, peak_slope=steep)
    out[N_CHANNELS:_STEEP] = np.clip((of.image - of.reference).transpose(2, 0, 1) / _GREY, -_MOST, _MOST)
    out[_STEEP] = math.log(steep / _USUAL_SLOPE)
    described = optics.require_optics(source)
    if isinstance(light, Optics):
        if light != described:
            _lamps(out, described, light)
    elif isinstance(light, str):
        out[_FOUND] = 0.0 if light == "sure" else _NEAR
    elif light is not None:
        out[_FOUND] = _FIELD
    if source.name in _LEARNED_AS:
        out[_SENSOR + TRAINED_SENSORS.index(_LEARNED_AS[source.name])] = 1.0
    return out


def _lamps(out: Floats, described: Optics, found: Optics) -> None:
    pairs = list(zip(found.leds, described.leds, strict=True))
    for number, (lamp, told) in enumerate(pairs[:_LAMPS]):
        colour = int(np.argmax(told.rgb))
        out[_BRIGHTER + number] = math.log(lamp.rgb[colour] / told.rgb[colour]) / _POWER
    out[_HIGHER] = float(np.mean([lamp.elevation_deg - told.elevation_deg for lamp, told in pairs])) / _ELEVATION_DEG
    out[_FOUND] = 1.0
