"""A gel's surface in the light of low lamps that dents hide, where a lamp's light is lost once.

The description has one elevation for how lamps shade a slope and another, lower one, for the shadows that dents cast,
and takes both from the same light: a pixel in a shadow loses on a slope, too, what does not get there. On a real DIGIT
the shadow is as long and as dark as the shading is strong: direct light is lost once, by whichever takes it. Here

    light = (R + R0) (1 + sum_n share_n (facing_n(grad z) seen_n(z) - 1)),    facing = max(0, l . n) / l_z,

with R the untouched picture, share_n (3,) what lamp n gives of every colour on level ground, seen_n how much of it gets
past the surface at the lamp's one elevation, and the rest scattered light that no dent changes. Rounds are those of
`gel_light` in a light that is sure; what the lens cannot show of a round's step is left out of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.physics.slopes import slopes
from pipeline.sensors.glow import untouched_light
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import gel_light
from pipeline.stages.depth.gel_light import Seen
from pipeline.stages.depth.poisson import Integrated, nearest
from pipeline.stages.depth.walls import raised

STEPS = 8  # towards the surface that is nearest to a round's slopes
_PULL = 100.0  # grey levels squared per unit slope squared, as `gel_light` has it
_STEEPEST = np.float32(1.43)  # mm/mm, 55 degrees
_LEAST_MM, _MOST = -0.5, 2.0  # no gel bulges out farther; times the deepest, on the way to a surface
_DARK_GREY = np.float32(2.0)  # R0: a camera's black is not quite none
_DIM = np.float32(0.01)  # per grey level: light is told by its share


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamps:
    """Lamps of which a surface loses light once."""

    azimuth: Doubles  # (n,) rad
    elevation: Doubles  # (n,) rad
    share: Doubles  # (3, n) of every colour's light on level ground

    @property
    def towards(self) -> Floats:
        """Unit vectors (n, 3) toward them."""
        flat = np.cos(self.elevation)
        ways = [flat * np.cos(self.azimuth), flat * np.sin(self.azimuth), np.sin(self.elevation)]
        return np.stack(ways, axis=1).astype(np.float32)


def described(source: SensorSpec) -> Lamps:
    """The lamps that change as many grey levels by a slope, and darken as much by a shadow, as the description's."""
    told = optics.optics_of(source)
    rgb = np.array([led.rgb for led in told.leds]).T  # (3, n)
    share = told.shadow * rgb / np.maximum(rgb.sum(axis=1, keepdims=True), 1e-6)
    usual = untouched_light(source.camera, told).reshape(-1, 3).mean(axis=0)
    up = np.radians([led.elevation_deg for led in told.leds])
    by_slope = (rgb * np.cos(up) / (1.0 - np.sin(up)) * (1.0 - 0.5 * told.falloff)).max(axis=0)  # grey per mm/mm
    own = rgb.argmax(axis=0), range(len(up))
    elevation = np.arctan(share[own] * usual[own[0]] / by_slope)
    return Lamps(azimuth=np.radians([led.azimuth_deg for led in told.leds]), elevation=elevation, share=share)


def corrected(
    surface_mm: Floats, picture: Seen, source: SensorSpec, lamps: Lamps, integrated: Integrated, rounds: int, steps: int
) -> tuple[Floats, float]:
    """The surface (rows, cols) of the pixels whose picture, by these lamps, comes nearest to the one seen.

    And what it leaves of it, summed before the last round: grey levels, of which bright ones count less.
    """
    from pipeline.stages.depth.cast_light_kernels import explained

    misfit, sure, level, drawn = 0.0, np.empty_like(picture.change), _level(picture), picture.still + picture.change
    limits = (np.float32(_PULL), np.float32(gel_light.HUBER_GREY), _STEEPEST, gel_light.OUTSIDE)
    counts, share = certain(picture), np.ascontiguousarray(lamps.share, np.float32)
    for _ in range(rounds):
        z = within(surface_mm, picture, source)
        gx, gy = slopes(z, picture.pixel_mm)
        seen = passed(lamps, z, picture.pixel_mm)
        rest = picture.change - gel_light.recorded(shown(lamps, picture, seen, gx, gy), source, picture)
        misfit = explained(
            rest, drawn, counts, picture.moved, level, seen, lamps.towards, share, limits, gx, gy, sure
        )  # fmt: skip
        whole = raised(surface_mm, (gx, gy), sure, picture.pixel_mm)
        step = nearest(whole, (gx, gy), sure, picture.pixel_mm, integrated, steps) - surface_mm
        surface_mm = surface_mm + gel_light.blurred(step, source, picture)
    return surface_mm, misfit


def within(surface_mm: Floats, picture: Seen, source: SensorSpec) -> Floats:
    """The surface (rows, cols) not far beyond where the sensor's gel goes; at rest where nothing has moved."""
    return np.clip(surface_mm, _LEAST_MM, _MOST * source.limits.indentation_max_mm) * picture.moved


def certain(picture: Seen) -> Floats:
    """How much every colour (rows, cols, 3) counts: noise is a share of the light, beside what a camera adds."""
    return np.asarray(picture.bare / np.hypot(1.0, _DIM * (picture.still + picture.change)), np.float32)


def passed(lamps: Lamps, surface_mm: Floats, pixel_mm: float) -> Floats:
    """The share of each lamp's light (n, rows, cols) that gets past the surface."""
    covers = optics.hidden(surface_mm, lamps.towards[:, :2], np.tan(lamps.elevation), pixel_mm)
    return np.stack([1.0 - cover for cover in covers])


def shown(lamps: Lamps, picture: Seen, seen: Floats, gx: Floats, gy: Floats) -> Floats:
    """Grey levels (rows, cols, 3) that slopes change before the lens, where `seen` of the lamps gets there."""
    from pipeline.stages.depth.cast_light_kernels import lit

    out = np.empty_like(picture.change)
    lit(gx, gy, _level(picture), seen, lamps.towards, np.ascontiguousarray(lamps.share, np.float32), out)
    return out


def _level(picture: Seen) -> Floats:
    return picture.still + _DARK_GREY
