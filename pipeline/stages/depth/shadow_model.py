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
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.reference_light import compute_reference_light
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import surface_refinement
from pipeline.stages.depth.poisson import Integrator, solve_weighted_slopes
from pipeline.stages.depth.surface_refinement import ImagePatch
from pipeline.stages.depth.wall_correction import raise_walls

CG_STEPS = 8  # towards the surface that is nearest to a round's slopes
_PULL = 100.0  # grey levels squared per unit slope squared, as `gel_light` has it
_STEEPEST = np.float32(1.43)  # mm/mm, 55 degrees
_LEAST_MM, _MOST = -0.5, 2.0  # no gel bulges out farther; times the deepest, on the way to a surface
_DARK_GREY = np.float32(2.0)  # R0: a camera's black is not quite none
_DIM = np.float32(0.01)  # per grey level: light is told by its share


@dataclass(frozen=True, slots=True, kw_only=True)
class LedArray:
    """Lamps of which a surface loses light once."""

    azimuth_rad: Doubles  # (n,) rad
    elevation_rad: Doubles  # (n,) rad
    colour_share: Doubles  # (3, n) of every colour's light on level ground

    @property
    def directions(self) -> Floats:
        """Unit vectors (n, 3) toward them."""
        flat = np.cos(self.elevation_rad)
        ways = [flat * np.cos(self.azimuth_rad), flat * np.sin(self.azimuth_rad), np.sin(self.elevation_rad)]
        return np.stack(ways, axis=1).astype(np.float32)


def make_described_leds(source: SensorSpec) -> LedArray:
    """The lamps that change as many grey levels by a slope, and darken as much by a shadow, as the description's."""
    told = optics.require_optics(source)
    rgb = np.array([led.rgb for led in told.leds]).T  # (3, n)
    share = told.shadow * rgb / np.maximum(rgb.sum(axis=1, keepdims=True), 1e-6)
    usual = compute_reference_light(source.camera, told).reshape(-1, 3).mean(axis=0)
    up = np.radians([led.elevation_deg for led in told.leds])
    by_slope = (rgb * np.cos(up) / (1.0 - np.sin(up)) * (1.0 - 0.5 * told.falloff)).max(axis=0)  # grey per mm/mm
    own = rgb.argmax(axis=0), range(len(up))
    elevation = np.arctan(share[own] * usual[own[0]] / by_slope)
    return LedArray(
        azimuth_rad=np.radians([led.azimuth_deg for led in told.leds]), elevation_rad=elevation, colour_share=share
    )


def refine_surface(
    surface_mm: Floats,
    picture: ImagePatch,
    source: SensorSpec,
    leds: LedArray,
    integrated: Integrator,
    iterations: int,
    cg_steps: int,
) -> tuple[Floats, float]:
    """The surface (rows, cols) of the pixels whose picture, by these lamps, comes nearest to the one seen.

    And what it leaves of it, summed before the last round: grey levels, of which bright ones count less.
    """
    from pipeline.stages.depth.shadow_model_kernels import update_slopes

    misfit, sure, level, drawn = 0.0, np.empty_like(picture.change), _level(picture), picture.reference + picture.change
    limits = (
        np.float32(_PULL),
        np.float32(surface_refinement.HUBER_GREY),
        _STEEPEST,
        surface_refinement.OUTSIDE_WEIGHT,
    )
    counts, share = compute_confidence(picture), np.ascontiguousarray(leds.colour_share, np.float32)
    for _ in range(iterations):
        z = clip_surface(surface_mm, picture, source)
        gx, gy = compute_slopes(z, picture.pixel_mm)
        seen = compute_visibility(leds, z, picture.pixel_mm)
        rest = picture.change - surface_refinement.simulate_recorded_change(
            render_change(leds, picture, seen, gx, gy), source, picture
        )
        misfit = update_slopes(
            rest, drawn, counts, picture.changed, level, seen, leds.directions, share, limits, gx, gy, sure
        )  # fmt: skip
        whole = raise_walls(surface_mm, (gx, gy), sure, picture.pixel_mm)
        step = solve_weighted_slopes(whole, (gx, gy), sure, picture.pixel_mm, integrated, cg_steps) - surface_mm
        surface_mm = surface_mm + surface_refinement.blur_change(step, source, picture)
    return surface_mm, misfit


def clip_surface(surface_mm: Floats, picture: ImagePatch, source: SensorSpec) -> Floats:
    """The surface (rows, cols) not far beyond where the sensor's gel goes; at rest where nothing has moved."""
    return np.clip(surface_mm, _LEAST_MM, _MOST * source.limits.indentation_max_mm) * picture.changed


def compute_confidence(picture: ImagePatch) -> Floats:
    """How much every colour (rows, cols, 3) counts: noise is a share of the light, beside what a camera adds."""
    return np.asarray(picture.unmarked_share / np.hypot(1.0, _DIM * (picture.reference + picture.change)), np.float32)


def compute_visibility(leds: LedArray, surface_mm: Floats, pixel_mm: float) -> Floats:
    """The share of each lamp's light (n, rows, cols) that gets past the surface."""
    covers = optics.iterate_led_shadows(surface_mm, leds.directions[:, :2], np.tan(leds.elevation_rad), pixel_mm)
    return np.stack([1.0 - cover for cover in covers])


def render_change(leds: LedArray, picture: ImagePatch, seen: Floats, gx: Floats, gy: Floats) -> Floats:
    """Grey levels (rows, cols, 3) that slopes change before the lens, where `seen` of the lamps gets there."""
    from pipeline.stages.depth.shadow_model_kernels import render_pixels

    out = np.empty_like(picture.change)
    render_pixels(
        gx, gy, _level(picture), seen, leds.directions, np.ascontiguousarray(leds.colour_share, np.float32), out
    )
    return out


def _level(picture: ImagePatch) -> Floats:
    return picture.reference + _DARK_GREY
