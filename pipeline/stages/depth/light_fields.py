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
from pipeline.stages.depth import network_input, own_light
from pipeline.stages.depth.network_input import FIELDS, Seen

ALL_FIELDS = FIELDS + 12
LEARNED = ("gelslim", "digit", "gelsight_mini")
# Without printed markers a GelSlim is lit the same; nothing was learned from it by itself.
_LEARNED_AS = {**{name: name for name in LEARNED}, "gelslim_dotless": "gelslim"}
_GREY, _MOST = 60.0, 4.0
_USUAL_SLOPE = 0.5
_LAMPS, _POWER, _ELEVATION_DEG = 3, 0.15, 3.0  # what units differ by, about
_STEEP, _BRIGHTER, _HIGHER, _FOUND, _SENSOR = FIELDS + 3, FIELDS + 4, FIELDS + 7, FIELDS + 8, FIELDS + 9
_NEAR, _FIELD = -1.0, -2.0  # lamps close beside, or none


def why_not(source: SensorSpec, light: own_light.Told | None) -> str:
    """Why nothing was learned of such a touch, another sensor or a light that physics cannot explain; "" if it was."""
    if source.name not in _LEARNED_AS:
        return f"the network has not learned from {source.name}: it was not asked, and physics' answer stands"
    if not own_light.explains(light):
        return "no usual unit's lamps explain the picture: the network was not asked, and physics' answer stands"
    return ""


def fields(of: Seen, source: SensorSpec, light: own_light.Told | None) -> Floats:
    """All fields (28, 120, 160): those of `network_input` and these."""
    out = np.zeros((ALL_FIELDS, network_input.ROWS, network_input.COLS), np.float32)
    steep = network_input.steepest(of)
    out[:FIELDS] = network_input.fields(of, steep=steep)
    out[FIELDS:_STEEP] = np.clip((of.touched - of.untouched).transpose(2, 0, 1) / _GREY, -_MOST, _MOST)
    out[_STEEP] = math.log(steep / _USUAL_SLOPE)
    described = optics.optics_of(source)
    if isinstance(light, Optics):
        if light != described:
            _lamps(out, described, light)
    elif isinstance(light, str):
        out[_FOUND] = 0.0 if light == "sure" else _NEAR
    elif light is not None:
        out[_FOUND] = _FIELD
    if source.name in _LEARNED_AS:
        out[_SENSOR + LEARNED.index(_LEARNED_AS[source.name])] = 1.0
    return out


def _lamps(out: Floats, described: Optics, found: Optics) -> None:
    pairs = list(zip(found.leds, described.leds, strict=True))
    for number, (lamp, told) in enumerate(pairs[:_LAMPS]):
        colour = int(np.argmax(told.rgb))
        out[_BRIGHTER + number] = math.log(lamp.rgb[colour] / told.rgb[colour]) / _POWER
    out[_HIGHER] = float(np.mean([lamp.elevation_deg - told.elevation_deg for lamp, told in pairs])) / _ELEVATION_DEG
    out[_FOUND] = 1.0
