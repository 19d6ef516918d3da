"""Seeded variation of sensors: other instances of a sensor, or the same one on another day.

Instances differ: LEDs are displaced and age, gels vary in stiffness and thickness, markers in their
print, dust lies on the lens. Strength 1 spans the differences between the instances of a lab.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pipeline.core.errors import SettingProblem
from pipeline.sensors.parts import Bubble, Gel, Glow, Led, Markers, Optics
from pipeline.sensors.spec import SensorSpec

MAX_STRENGTH = 3.0
_LED_AZIMUTH_DEG = 8.0  # standard deviation at strength 1, as all below
_LED_ELEVATION_DEG = 3.0
_LED_POWER = 0.12  # of the logarithm, as all shares below
_LED_COLOUR = 0.08
_GLOW_POWER = 0.10
_GLOW_COLOUR = 0.05
_GLOW_PLACE = 0.06  # halves of the image
_BASE = 0.05
_FALLOFF = 0.05
_VIGNETTE = 0.08
_BLUR = 0.15
_NOISE = 0.20
_SHADOW = 0.25
_STIFFNESS = 0.20
_THICKNESS = 0.08
_PITCH = 0.02
_DOT = 0.08
_ROTATION_DEG = 0.8
_DISTORTION = 0.01
_MAX_DUST = 3  # specks at strength 1
_DUST_HALVES = 0.012  # their size in halves of the image
_DUST_GREY = 14.0
_PRESSURE = 0.10


def vary_sensor(sensor: SensorSpec, seed: int, strength: float = 1.0) -> SensorSpec:
    """Another instance of `sensor`, the same for the same seed.

    Camera and frames stay. Strength 0 changes nothing.

    Values are cut at 2.5 standard deviations and at the limits of a sensor description.
    Raises SettingProblem for a strength outside 0 to `MAX_STRENGTH`.
    """
    if not 0.0 <= strength <= MAX_STRENGTH:  # refuses NaN, too
        raise SettingProblem(
            f"the strength of variation must lie between 0 and {MAX_STRENGTH:g}, got {strength!r}"
        )
    if strength == 0.0:
        return sensor
    # One stream for each part, so that its values do not depend on the other parts.
    optics, gel, markers, bubble = (
        _Draw(s, strength) for s in np.random.SeedSequence(seed % 2**64).spawn(4)
    )
    return replace(
        sensor,
        optics=None if sensor.optics is None else _optics(sensor.optics, optics),
        gel=None if sensor.gel is None else _gel(sensor.gel, gel),
        markers=None if sensor.markers is None else _markers(sensor.markers, markers),
        bubble=None if sensor.bubble is None else _bubble(sensor.bubble, bubble),
    )


class _Draw:
    """Bounded normal values for one part of a sensor."""

    def __init__(self, seed: np.random.SeedSequence, strength: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._strength = strength

    def sample_offset(self, deviation: float) -> float:
        """An offset about 0."""
        return float(np.clip(self._rng.normal(), -2.5, 2.5)) * deviation * self._strength

    def sample_factor(self, deviation: float) -> float:
        """A factor about 1."""
        return math.exp(self.sample_offset(deviation))

    def sample_uniform(self, low: float, high: float) -> float:
        """A uniform value, whatever the strength."""
        return float(self._rng.uniform(low, high))

    def tint_colour(
        self, rgb: tuple[float, float, float], power: float, colour: float
    ) -> tuple[float, float, float]:
        """A colour with its brightness varied, and each channel a little more."""
        whole = self.sample_factor(power)
        red, green, blue = (v * whole * self.sample_factor(colour) for v in rgb)
        return red, green, blue


def _optics(o: Optics, draw: _Draw) -> Optics:
    leds = tuple(
        Led(
            azimuth_deg=(led.azimuth_deg + draw.sample_offset(_LED_AZIMUTH_DEG)) % 360.0,
            elevation_deg=min(
                max(led.elevation_deg + draw.sample_offset(_LED_ELEVATION_DEG), 5.0), 80.0
            ),
            rgb=draw.tint_colour(led.rgb, _LED_POWER, _LED_COLOUR),
        )
        for led in o.leds
    )
    glows = tuple(
        Glow(
            x=g.x + draw.sample_offset(_GLOW_PLACE),
            y=g.y + draw.sample_offset(_GLOW_PLACE),
            width=g.width * draw.sample_factor(_GLOW_PLACE),
            height=g.height * draw.sample_factor(_GLOW_PLACE),
            rgb=draw.tint_colour(g.rgb, _GLOW_POWER, _GLOW_COLOUR),
        )
        for g in o.glows
    )
    return replace(
        o,
        base_rgb=draw.tint_colour(o.base_rgb, _BASE, _BASE),
        leds=leds,
        falloff=_share(o.falloff + draw.sample_offset(_FALLOFF)),
        vignette=_share(o.vignette + draw.sample_offset(_VIGNETTE)),
        blur_px=o.blur_px * draw.sample_factor(_BLUR),
        noise_grey=o.noise_grey * draw.sample_factor(_NOISE),
        glows=(*glows, *_dust(draw)),
        shadow=_share(o.shadow * draw.sample_factor(_SHADOW)),
        shadow_deg=min(max(o.shadow_deg + draw.sample_offset(_LED_ELEVATION_DEG), 5.0), 80.0),
    )


def _dust(draw: _Draw) -> Iterator[Glow]:
    """A few fixed bright or dark specks."""
    for _ in range(min(_MAX_DUST, round(abs(draw.sample_offset(0.5 * _MAX_DUST))))):
        size = _DUST_HALVES * draw.sample_factor(0.3)
        grey = draw.sample_offset(_DUST_GREY)
        x, y = (draw.sample_uniform(-1.0, 1.0) for _ in range(2))
        yield Glow(x=x, y=y, width=size, height=size, rgb=(grey, grey, grey))


def _gel(g: Gel, draw: _Draw) -> Gel:
    thickness_mm = g.thickness_mm * draw.sample_factor(_THICKNESS)
    youngs_kpa = g.youngs_kpa * draw.sample_factor(_STIFFNESS)
    return replace(g, thickness_mm=thickness_mm, youngs_kpa=youngs_kpa)


def _markers(m: Markers, draw: _Draw) -> Markers:
    pitch = m.pitch_mm * draw.sample_factor(_PITCH)
    # The phase of the grid is arbitrary between instances; a weak variation changes it little.
    half = 0.5 * pitch
    phase = tuple(min(max(p + draw.sample_offset(half), -half), half) for p in m.phase_mm)
    return Markers(
        pitch_mm=pitch,
        radius_mm=min(m.radius_mm * draw.sample_factor(_DOT), 0.3 * pitch),
        darkness=_share(m.darkness + draw.sample_offset(0.5 * _DOT)),
        doubling_mm=min(m.doubling_mm * draw.sample_factor(_DOT), 0.3 * pitch),
        jitter_mm=min(m.jitter_mm * draw.sample_factor(2 * _DOT), 0.15 * pitch),
        distortion=min(max(m.distortion + draw.sample_offset(_DISTORTION), -0.2), 0.2),
        rotation_deg=m.rotation_deg + draw.sample_offset(_ROTATION_DEG),
        phase_mm=(phase[0], phase[1]),
    )


def _bubble(b: Bubble, draw: _Draw) -> Bubble:
    return replace(
        b,
        pressure_kpa=b.pressure_kpa * draw.sample_factor(_PRESSURE),
        dead_volume_mm3=b.dead_volume_mm3 * draw.sample_factor(_PRESSURE),
        depth_noise_mm=b.depth_noise_mm * draw.sample_factor(_NOISE),
    )


def _share(value: float) -> float:
    return min(max(value, 0.0), 1.0)
