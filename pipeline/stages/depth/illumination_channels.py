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

import functools
import math

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.physics import optics
from pipeline.sensors.parts import Led, Optics
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.depth import gel_network_input
from pipeline.stages.depth.gel_network_input import N_CHANNELS, NetworkInput
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.illumination.selection import get_optics

N_ALL_CHANNELS = N_CHANNELS + 12
TRAINED_SENSORS = ("gelslim", "digit", "gelsight_mini")
_GREY, _MAX_CHANGE = 60.0, 4.0  # grey levels of one unit of the channel, and its largest value
_USUAL_SLOPE = 0.5  # mm/mm
_N_LEDS, _LOG_POWER, _ELEVATION_DEG, _AZIMUTH_DEG = 3, 0.15, 3.0, 8.0  # standard deviations between instances, about
_LARGEST_DEVIATION = 2.5  # standard deviations within which training instances vary (`simulation.variation`)
_STEEP, _BRIGHTER, _HIGHER, _LEDS, _SENSOR = (N_CHANNELS + k for k in (3, 4, 7, 8, 9))
_UNEXPLAINED = {"described": -1.0, "near": -1.0, "shadow_leds": -2.0, "field": -2.0}  # values of channel 24


def match_trained_sensor(source: SensorSpec) -> str:
    """The sensor trained on whose instances may have the described LEDs of this one; "" for none.

    A description of one's own keeps the network as long as each LED stays within the variation of instances.
    """
    leds = () if source.optics is None else source.optics.leds
    return next((name for name in TRAINED_SENSORS if _are_alike(leds, _load_leds(name))), "")


@functools.cache
def _load_leds(name: str) -> tuple[Led, ...]:
    return optics.require_optics(load_sensor(name)).leds


def _are_alike(leds: tuple[Led, ...], trained: tuple[Led, ...]) -> bool:
    return len(leds) == len(trained) and all(
        max(_compute_deviations(*pair)) <= _LARGEST_DEVIATION for pair in zip(leds, trained, strict=True)
    )


def _compute_deviations(led: Led, trained: Led) -> tuple[float, float, float]:
    """How far an LED is from one trained on, in standard deviations: azimuth, elevation, logarithm of its power."""
    colour = int(np.argmax(trained.rgb))
    turn_deg = (led.azimuth_deg - trained.azimuth_deg + 180.0) % 360.0 - 180.0
    power = led.rgb[colour] / trained.rgb[colour]
    return (
        abs(turn_deg) / _AZIMUTH_DEG,
        abs(led.elevation_deg - trained.elevation_deg) / _ELEVATION_DEG,
        abs(math.log(power)) / _LOG_POWER if power > 0.0 else math.inf,
    )


def explain_exclusion(source: SensorSpec, illumination: Illumination | None) -> str:
    """Why the network was not trained on such a touch: other LEDs, or unexplained light; "" if it was."""
    if not match_trained_sensor(source):
        return (
            f"the network was not trained on LEDs such as those of {source.name}: the result is that of physics alone"
        )
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
    trained = match_trained_sensor(source)
    if trained:
        out[_SENSOR + TRAINED_SENSORS.index(trained)] = 1.0
    return out


def _write_leds(out: Floats, described: Optics, fitted: Optics) -> None:
    pairs = list(zip(fitted.leds, described.leds, strict=True))
    for number, (led, usual) in enumerate(pairs[:_N_LEDS]):
        colour = int(np.argmax(usual.rgb))
        out[_BRIGHTER + number] = math.log(led.rgb[colour] / usual.rgb[colour]) / _LOG_POWER
    out[_HIGHER] = float(np.mean([led.elevation_deg - usual.elevation_deg for led, usual in pairs])) / _ELEVATION_DEG
    out[_LEDS] = 1.0
