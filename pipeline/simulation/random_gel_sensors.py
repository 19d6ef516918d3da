"""Units of gel sensors that nobody has built: what lights them, and what their cameras add.

A network that is to read any unit has to be shown units that differ by more than any lab's do. A unit starts from a
sensor of the project, and everything about it is drawn anew: lights (number, place, colour, power, width), the
untouched picture, lens, shadows, the camera's tone, markers. The sensor's description knows the unit only roughly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.sensors.parts import Glow, Led, Markers, Optics
from pipeline.sensors.spec import SensorSpec, load_sensor

_KINDS = {"gelsight_mini": 0.3, "gelslim": 0.3, "gelslim_dotless": 0.12, "digit": 0.28}  # how likely
_RGB = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomGelSensor:
    """One sensor as it is, and as its description has it."""

    sensor: SensorSpec  # its optics tell what slopes change, `still` what is there before
    reference_light: Floats  # (rows, cols, 3) light of the untouched gel, grey levels
    nominal: SensorSpec  # what is known of it
    exposure: float  # the camera's against the described one
    gamma: float  # exponent of the camera's response
    colour_mixing: Doubles  # (3, 3) recorded colours of the light's colours
    falloff_from_reference: float  # 0: lamps fade as described; 1: as the untouched picture does
    brightening_per_mm: float  # share by which the light grows per mm that the surface comes nearer
    scattered_light: tuple[float, float]  # share of the change that the gel scatters around, and how far (mm)
    grain_grey: float  # of the gel's coating, which stays where it is


def sample_gel_sensor(rng: np.random.Generator) -> RandomGelSensor:
    """A random unit of a known kind, near its description or far from it."""
    name = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    base, far = load_sensor(name), float(rng.uniform(0.05, 0.8))
    drawn, markers = _askew(rng, _optics(base), far), _markers(rng, base, likely=0.97 if base.markers else 0.1)
    sometimes = rng.random(5)
    return RandomGelSensor(
        sensor=replace(base, optics=drawn, markers=markers),
        reference_light=_still(rng, drawn, base.camera.shape),
        nominal=base,
        exposure=math.exp(rng.normal(0.0, 0.2 * far)),
        gamma=math.exp(rng.normal(0.0, 0.15 * far)) if sometimes[0] < 0.5 else 1.0,
        colour_mixing=np.eye(3) + (rng.normal(0.0, 0.06 * far, (3, 3)) if sometimes[1] < 0.5 else 0.0),
        falloff_from_reference=far * float(rng.uniform(0.0, 1.0)) if sometimes[2] < 0.5 else 0.0,
        brightening_per_mm=far * float(rng.normal(0.0, 0.06)) if sometimes[3] < 0.5 else 0.0,
        scattered_light=(
            far * float(rng.uniform(-0.1, 0.2)) if sometimes[4] < 0.4 else 0.0,
            float(rng.uniform(0.5, 3.0)),
        ),
        grain_grey=float(rng.exponential(0.8)),
    )


def _still(rng: np.random.Generator, o: Optics, shape: tuple[int, int]) -> Floats:
    """The untouched light: base and glows, which fall off alike along x and y, and specks that neither move nor change.

    As `optics.untouched` has it before eight bits, without an exponential at every pixel.
    """
    y, x = ((np.arange(n, dtype=np.float32) + 0.5) / n * 2 - 1 for n in shape)
    down = np.array([np.ones_like(y)] + [np.exp(-(((y - g.y) / g.height) ** 2)) for g in o.glows], np.float32)
    across = np.array([np.ones_like(x)] + [np.exp(-(((x - g.x) / g.width) ** 2)) for g in o.glows], np.float32)
    colours = np.array([o.base_rgb, *(g.rgb for g in o.glows)], np.float32)
    light = (down.T @ (across[:, :, None] * colours[:, None, :]).reshape(len(colours), -1)).reshape(*shape, 3)
    light *= (1.0 - o.vignette * ((x[None, :] ** 2 + y[:, None] ** 2) / 2) ** 2)[..., None]
    for _ in range(int(rng.choice((0, 1, 3, 8), p=(0.5, 0.25, 0.15, 0.1)))):
        row, col, size = int(rng.integers(shape[0] - 9)), int(rng.integers(shape[1] - 9)), int(rng.integers(2, 9))
        light[row : row + size, col : col + size] += np.float32(rng.normal(0.0, 25.0))
    return freeze(light.astype(np.float32, copy=False))


def _optics(described: SensorSpec) -> Optics:
    assert described.optics is not None
    return described.optics


def _askew(rng: np.random.Generator, o: Optics, far: float) -> Optics:
    """A unit of this description, `far` (0 to 1) off.

    At 1, its lights stray one and a half times as far as units of a lab do (`variation`).
    """
    power = math.exp(rng.normal(0.0, 0.18 * far))
    wide = float(rng.uniform(0.0, 35.0))
    leds: list[Led] = []
    for led in o.leds:
        azimuth, rgb = (
            led.azimuth_deg + rng.normal(0.0, 12.0 * far),
            _tinted(rng, led.rgb, power, 0.18 * far, 0.1 * far),
        )
        elevation = float(np.clip(led.elevation_deg + rng.normal(0.0, 5.0 * far), 7.0, 65.0))
        if rng.random() < 0.3:
            rgb = _bled(rng, rgb)
        leds += _bar(rng, azimuth, elevation, rgb, wide)
    glows = [_moved(rng, glow) for glow in o.glows]
    if rng.random() < 0.5:
        glows.append(_glow(rng, 40.0))
    return replace(
        o, blur_px=o.blur_px * math.exp(rng.normal(0.0, 0.3 * far)), leds=tuple(leds), glows=tuple(glows),
        base_rgb=_tinted(rng, o.base_rgb, 1.0, 0.2, 0.2), **_lens(rng, o.falloff, o.vignette, far),
    )  # fmt: skip


def _moved(rng: np.random.Generator, g: Glow) -> Glow:
    x, y = g.x + rng.normal(0.0, 0.12), g.y + rng.normal(0.0, 0.12)
    width, height = (size * math.exp(rng.normal(0.0, 0.15)) for size in (g.width, g.height))
    return Glow(x=x, y=y, width=width, height=height, rgb=_tinted(rng, g.rgb, 1.0, 0.25, 0.15))


def _bar(rng: np.random.Generator, azimuth: float, elevation: float, rgb: _RGB, wide_deg: float) -> list[Led]:
    """A row of lamps instead of one: its attached shadow has no sharp edge."""
    n = int(rng.integers(1, 4)) if wide_deg > 3.0 else 1
    spread = np.linspace(-0.5, 0.5, n) if n > 1 else np.zeros(1)
    high = rng.normal(0.0, 4.0, n) if n > 1 else np.zeros(1)
    each = _rgb(np.array(rgb) / n)
    return [
        Led(
            azimuth_deg=(azimuth + wide_deg * float(aside)) % 360.0,
            elevation_deg=float(np.clip(elevation + higher, 5.0, 70.0)),
            rgb=each,
        )
        for aside, higher in zip(spread, high, strict=True)
    ]


def _lens(rng: np.random.Generator, falloff: float, vignette: float, far: float) -> dict[str, float]:
    shadow = rng.uniform(0.1, 0.9) if rng.random() < 0.5 else 0.0
    return {
        "falloff": _share(falloff + rng.normal(0.0, 0.15 * far)),
        "vignette": _share(vignette + rng.normal(0.0, 0.2 * far)),
        "shadow": float(shadow), "shadow_deg": float(rng.uniform(8.0, 30.0)),
    }  # fmt: skip


def _glow(rng: np.random.Generator, grey: float) -> Glow:
    x, y = rng.uniform(-1.2, 1.2, 2)
    width, height = np.exp(rng.uniform(math.log(0.25), math.log(1.6), 2))
    return Glow(
        x=float(x),
        y=float(y),
        width=float(width),
        height=float(height),
        rgb=_rgb(rng.normal(0.0, 1.0, 3) * rng.uniform(0.0, grey)),
    )


def _markers(rng: np.random.Generator, base: SensorSpec, likely: float) -> Markers | None:
    """Dots of the sensor's own grid, or of any."""
    if rng.random() > likely:
        return None
    pitch = math.exp(rng.uniform(math.log(0.8), math.log(3.2)))
    radius = pitch * rng.uniform(0.06, 0.22)
    if base.markers is not None and rng.random() < 0.7:
        pitch = base.markers.pitch_mm * math.exp(rng.normal(0.0, 0.1))
        radius = base.markers.radius_mm * math.exp(rng.normal(0.0, 0.2))
    darkness, doubled = float(rng.uniform(0.35, 0.97)), float(rng.choice((0.0, 1.0)))
    return Markers(
        pitch_mm=pitch, radius_mm=radius, darkness=darkness,
        doubling_mm=doubled * radius * float(rng.uniform(0.5, 1.6)), jitter_mm=0.08 * pitch * float(rng.random()),
        distortion=float(rng.normal(0.0, 0.04)), rotation_deg=float(rng.normal(0.0, 3.0) + rng.choice((0.0, 90.0))),
        phase_mm=(float(rng.uniform(-0.5, 0.5)) * pitch, float(rng.uniform(-0.5, 0.5)) * pitch),
    )  # fmt: skip


def _tinted(rng: np.random.Generator, rgb: _RGB, power: float, whole: float, each: float) -> _RGB:
    return _rgb(np.array(rgb) * power * math.exp(rng.normal(0.0, whole)) * np.exp(rng.normal(0.0, each, 3)))


def _bled(rng: np.random.Generator, rgb: _RGB) -> _RGB:
    """A lamp whose colour is seen by the other channels too."""
    return _rgb(np.array(rgb) + max(rgb) * rng.uniform(0.0, 0.25, 3))


def _rgb(values: Doubles) -> _RGB:
    red, green, blue = (float(v) for v in values)
    return red, green, blue


def _share(value: float) -> float:
    return float(min(max(value, 0.0), 0.9))
