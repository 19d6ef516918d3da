"""Gel sensors that nobody has built: what lights them, what their cameras add, and what of it a description knows.

A network that is to read any unit has to be shown units that differ by more than any lab's do. A unit starts from a
sensor of the project or from nothing, and everything about it is drawn anew: lights (number, place, colour, power,
width), the untouched picture, lens, shadows, the camera's tone, markers. `nominal` is what somebody would have written
into the sensor's description: it knows the unit only roughly, sometimes wrongly, sometimes not at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.geometry import membrane
from pipeline.geometry.camera import Camera
from pipeline.sensors.parts import Glow, Led, Markers, Optics
from pipeline.sensors.spec import SensorSpec, sensor

ROWS, COLS = 120, 160  # of the pictures: what networks look at
PIXEL_MM = 0.125
_REST_MM = 25.0
_FAMILIES = ("gelsight_mini", "gelslim", "digit")
_RGB = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """One sensor as it is, and as its description has it."""

    sensor: SensorSpec  # (120, 160); its optics tell what slopes change, `still` what is there before
    still: Floats  # (120, 160, 3) light of the untouched gel, grey levels
    nominal: SensorSpec | None  # None = nobody has described its lights
    exposure: float  # the camera's against the described one
    tone: float  # exponent of the camera's response
    mixing: Doubles  # (3, 3) recorded colours of the light's colours
    following: float  # 0: lamps fade as described; 1: as the untouched picture does
    nearer: float  # share by which the light grows per mm that the surface comes nearer
    bounced: tuple[float, float]  # share of the change that the gel scatters around, and how far (pixels)
    grain_grey: float  # of the gel's coating, which stays where it is


def unit(rng: np.random.Generator) -> Unit:
    """A random unit: mostly one of a known kind, near its description or far from it, seldom one that nobody knows."""
    family = str(rng.choice((*_FAMILIES, ""), p=(0.31, 0.31, 0.28, 0.10)))
    base = _seen_small(family or "gelsight_mini")
    far = float(rng.uniform(0.2, 1.0)) if family else 1.0
    drawn = _askew(rng, _optics(base), far) if family else _invented(rng)
    actual = replace(
        base, optics=drawn, markers=_markers(rng, base.markers, likely=0.75 if family == "gelslim" else 0.2)
    )
    nominal = base if family else replace(base, optics=_lamps_alone(_askew(rng, drawn, 1.0, lights_only=True)))
    sometimes = rng.random(5)
    return Unit(
        sensor=actual,
        still=_still(rng, drawn),
        nominal=None if rng.random() < (0.02 if family else 0.25) else nominal,
        exposure=math.exp(rng.normal(0.0, 0.2 * far)),
        tone=math.exp(rng.normal(0.0, 0.15 * far)) if sometimes[0] < 0.5 else 1.0,
        mixing=np.eye(3) + (rng.normal(0.0, 0.06 * far, (3, 3)) if sometimes[1] < 0.5 else 0.0),
        following=far * float(rng.uniform(0.0, 1.0)) if sometimes[2] < 0.5 else 0.0,
        nearer=far * float(rng.normal(0.0, 0.06)) if sometimes[3] < 0.5 else 0.0,
        bounced=(far * float(rng.uniform(-0.1, 0.2)) if sometimes[4] < 0.4 else 0.0, float(rng.uniform(4.0, 25.0))),
        grain_grey=float(rng.exponential(0.8)),
    )


@lru_cache(maxsize=8)
def _seen_small(name: str) -> SensorSpec:
    """A sensor of the project on the small picture; a portrait sensor lies on its side (mirrored at the diagonal)."""
    full = sensor(name)
    camera = Camera(rows=ROWS, cols=COLS, fx_px=_REST_MM / PIXEL_MM, fy_px=_REST_MM / PIXEL_MM,
                    cx_px=0.5 * (COLS - 1), cy_px=0.5 * (ROWS - 1))  # fmt: skip
    surface = membrane.flat(_REST_MM, COLS * PIXEL_MM, ROWS * PIXEL_MM)
    optics = replace(_optics(full), blur_px=0.0, noise_grey=0.0)
    if full.camera.rows > full.camera.cols:
        optics = mirrored(optics)
    return replace(full, camera=camera, membrane=surface, rest_depth_mm=surface.rest_depth_mm(camera), optics=optics)


def mirrored(optics: Optics) -> Optics:
    """The same light with x and y exchanged."""
    leds = tuple(replace(led, azimuth_deg=(90.0 - led.azimuth_deg) % 360.0) for led in optics.leds)
    glows = tuple(Glow(x=g.y, y=g.x, width=g.height, height=g.width, rgb=g.rgb) for g in optics.glows)
    return replace(optics, leds=leds, glows=glows)


def _lamps_alone(o: Optics) -> Optics:
    return replace(o, base_rgb=(0.0, 0.0, 0.0), glows=())


def _still(rng: np.random.Generator, o: Optics) -> Floats:
    """The untouched light: base and glows, which fall off alike along x and y, and specks that neither move nor change.

    As `optics.untouched` has it before eight bits, without an exponential at every pixel.
    """
    x = (np.arange(COLS, dtype=np.float32) + 0.5) / COLS * 2 - 1
    y = (np.arange(ROWS, dtype=np.float32) + 0.5) / ROWS * 2 - 1
    down = np.array([np.ones(ROWS)] + [np.exp(-(((y - g.y) / g.height) ** 2)) for g in o.glows], np.float32)
    across = np.array([np.ones(COLS)] + [np.exp(-(((x - g.x) / g.width) ** 2)) for g in o.glows], np.float32)
    colours = np.array([o.base_rgb, *(g.rgb for g in o.glows)], np.float32)
    light = (down.T @ (across[:, :, None] * colours[:, None, :]).reshape(len(colours), -1)).reshape(ROWS, COLS, 3)
    light *= (1.0 - o.vignette * ((x[None, :] ** 2 + y[:, None] ** 2) / 2) ** 2)[..., None]
    for _ in range(int(rng.choice((0, 1, 3, 8), p=(0.5, 0.25, 0.15, 0.1)))):
        row, col, size = int(rng.integers(2, ROWS - 3)), int(rng.integers(2, COLS - 3)), int(rng.integers(1, 4))
        light[row : row + size, col : col + size] += np.float32(rng.normal(0.0, 25.0))
    return freeze(light.astype(np.float32, copy=False))


def _optics(described: SensorSpec) -> Optics:
    assert described.optics is not None
    return described.optics


def _askew(rng: np.random.Generator, o: Optics, far: float, *, lights_only: bool = False) -> Optics:
    """A unit of this description, `far` (0 to 1) off; `lights_only`: the description that somebody made of it.

    At 1, its lights stray one and a half times as far as units of a lab do (`variation`).
    """
    power = math.exp(rng.normal(0.0, 0.18 * far))
    wide = 0.0 if lights_only else float(rng.uniform(0.0, 35.0))
    leds: list[Led] = []
    for led in o.leds:
        azimuth, rgb = (
            led.azimuth_deg + rng.normal(0.0, 12.0 * far),
            _tinted(rng, led.rgb, power, 0.18 * far, 0.1 * far),
        )
        elevation = float(np.clip(led.elevation_deg + rng.normal(0.0, 5.0 * far), 7.0, 65.0))
        if not lights_only and rng.random() < 0.3:
            rgb = _bled(rng, rgb)
        leds += _bar(rng, azimuth, elevation, rgb, wide)
    if lights_only:
        return replace(o, leds=tuple(leds))
    glows = [_moved(rng, glow) for glow in o.glows]
    if rng.random() < 0.5:
        glows.append(_glow(rng, 40.0))
    return replace(
        o, leds=tuple(leds), glows=tuple(glows), base_rgb=_tinted(rng, o.base_rgb, 1.0, 0.2, 0.2),
        **_lens(rng, o.falloff, o.vignette, far),
    )  # fmt: skip


def _moved(rng: np.random.Generator, g: Glow) -> Glow:
    x, y = g.x + rng.normal(0.0, 0.12), g.y + rng.normal(0.0, 0.12)
    width, height = (size * math.exp(rng.normal(0.0, 0.15)) for size in (g.width, g.height))
    return Glow(x=x, y=y, width=width, height=height, rgb=_tinted(rng, g.rgb, 1.0, 0.25, 0.15))


def _invented(rng: np.random.Generator) -> Optics:
    """Lights of no known sensor: two to eight lamps of any colour around the gel."""
    count, power = int(rng.integers(2, 9)), math.exp(rng.uniform(math.log(70.0), math.log(350.0)))
    first, elevation = rng.uniform(0.0, 360.0), rng.uniform(12.0, 45.0)
    white, wide = rng.random() < 0.15, float(rng.uniform(0.0, 40.0))
    leds: list[Led] = []
    for k in range(count):
        hue = np.ones(3) if white else _hue(rng, None if count > 4 else k)
        rgb = _rgb(hue * power * math.exp(rng.normal(0.0, 0.2)) / max(1.0, count / 3.0))
        azimuth = first + 360.0 * k / count + rng.normal(0.0, 15.0)
        leds += _bar(rng, azimuth, float(np.clip(elevation + rng.normal(0.0, 5.0), 7.0, 65.0)), rgb, wide)
    base = _rgb(rng.uniform(10.0, 140.0) * np.exp(rng.normal(0.0, 0.4, 3)))
    glows = tuple(_glow(rng, 110.0) for _ in range(int(rng.integers(0, 7))))
    lens = _lens(rng, 0.4, 0.2, 1.0)
    return Optics(base_rgb=base, leds=tuple(leds), glows=glows, blur_px=0.0, noise_grey=0.0, **lens)


def _hue(rng: np.random.Generator, first: int | None) -> Doubles:
    """A colour of which most is red, green or blue; None = any of them."""
    rgb = (1.0, rng.uniform(0.0, 0.6) ** 2, rng.uniform(0.0, 0.4) ** 2)
    return np.roll(rgb, int(rng.integers(3)) if first is None else first)


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


def _markers(rng: np.random.Generator, own: Markers | None, likely: float) -> Markers | None:
    """Dots of any grid."""
    if rng.random() > likely:
        return None
    pitch = math.exp(rng.uniform(math.log(0.8), math.log(3.2)))
    radius = pitch * rng.uniform(0.06, 0.22)
    if rng.random() < 0.4:  # near to the sensor's own, which has some 0.1 mm to a pixel
        m = own or Markers(pitch_mm=pitch, radius_mm=radius, darkness=0.8)
        pitch = m.pitch_mm * math.exp(rng.normal(0.0, 0.1)) * 1.3
        radius = m.radius_mm * 1.3 * math.exp(rng.normal(0.0, 0.2))
    darkness, doubled = float(rng.uniform(0.35, 0.97)), float(rng.choice((0.0, 1.0)))
    return Markers(
        pitch_mm=pitch, radius_mm=radius, darkness=darkness,
        twin_mm=doubled * radius * float(rng.uniform(0.5, 1.6)), jitter_mm=0.08 * pitch * float(rng.random()),
        bend=float(rng.normal(0.0, 0.04)), turn_deg=float(rng.normal(0.0, 3.0) + rng.choice((0.0, 90.0))),
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
