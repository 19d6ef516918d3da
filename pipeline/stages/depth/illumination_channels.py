"""Input channels of a gel network that predicts the scale of a touch, besides those of `gel_network_input`.

    16-18  change of colour, in 60 grey levels
    19     logarithm of the largest slope that the described LEDs would make of it, over 0.5
    20-22  how much brighter the first fitted LEDs are than described, in standard deviations of sensor instances
    23     how much higher the LEDs stand on average, in standard deviations
    24     1 for fitted LEDs, 0 where the described ones will do, below 0 where no LEDs explain the image
    25-27  one-hot sensor of those trained on

A bright LED and a steep surface look alike but for the light's curvature, for saturation, and for what is known of a
sensor: instances differ by a tenth or so (`simulation.variation`).
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.physics import optics
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import gel_network_input
from pipeline.stages.depth.gel_network_input import N_CHANNELS, NetworkInput
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.illumination.selection import get_optics

N_ALL_CHANNELS = N_CHANNELS + 12
TRAINED_SENSORS = ("gelslim", "digit", "gelsight_mini")
# A GelSlim without printed markers has the same LEDs; no training data are its own.
_TRAINED_AS = {**{name: name for name in TRAINED_SENSORS}, "gelslim_dotless": "gelslim"}
_GREY, _MAX_CHANGE = 60.0, 4.0  # grey levels of one unit of the channel, and its largest value
_USUAL_SLOPE = 0.5  # mm/mm
_N_LEDS, _LOG_POWER, _ELEVATION_DEG = 3, 0.15, 3.0  # standard deviations between instances, about
_STEEP, _BRIGHTER, _HIGHER, _LEDS, _SENSOR = (N_CHANNELS + k for k in (3, 4, 7, 8, 9))
_UNEXPLAINED = {"described": -1.0, "near": -1.0, "shadow_leds": -2.0, "field": -2.0}  # values of channel 24


def explain_exclusion(source: SensorSpec, illumination: Illumination | None) -> str:
    """Why the network was not trained on such a touch: another sensor, or unexplained light; "" if it was."""
    if source.name not in _TRAINED_AS:
        return f"the network was not trained on {source.name}: the result is that of physics alone"
    if illumination is None or not illumination.is_trusted:
        return "no usual LEDs explain the image: the result is that of physics alone"
    return ""


def compute_all_channels(network_input: NetworkInput, source: SensorSpec, illumination: Illumination | None) -> Floats:
    """All channels (28, 120, 160): those of `gel_network_input` and these."""
    out = np.zeros((N_ALL_CHANNELS, gel_network_input.ROWS, gel_network_input.COLS), np.float32)
    steep = gel_network_input.compute_peak_slope(network_input)
    change = (network_input.image - network_input.reference).transpose(2, 0, 1)
    out[:N_CHANNELS] = gel_network_input.compute_channels(network_input, peak_slope=steep)
    out[N_CHANNELS:_STEEP] = np.clip(change / _GREY, -_MAX_CHANGE, _MAX_CHANGE)
    out[_STEEP] = math.log(steep / _USUAL_SLOPE)
    if illumination is not None:
        out[_LEDS] = _UNEXPLAINED.get(illumination.model, 0.0)
        if illumination.is_fitted_leds:
            _write_leds(out, optics.require_optics(source), get_optics(illumination, source))
    if source.name in _TRAINED_AS:
        out[_SENSOR + TRAINED_SENSORS.index(_TRAINED_AS[source.name])] = 1.0
    return out


def _write_leds(out: Floats, described: Optics, fitted: Optics) -> None:
    pairs = list(zip(fitted.leds, described.leds, strict=True))
    for number, (led, usual) in enumerate(pairs[:_N_LEDS]):
        colour = int(np.argmax(usual.rgb))
        out[_BRIGHTER + number] = math.log(led.rgb[colour] / usual.rgb[colour]) / _LOG_POWER
    out[_HIGHER] = float(np.mean([led.elevation_deg - usual.elevation_deg for led, usual in pairs])) / _ELEVATION_DEG
    out[_LEDS] = 1.0
