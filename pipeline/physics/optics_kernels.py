# pyright: basic
"""Compiled loops of the optics: one pass over the image, no temporaries."""

import math

import numpy as np
from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a NaN slope has to stay one


@njit(cache=True, fastmath=_FAST)
def lambert_change(gx, gy, leds, strength, vignette, out):
    """Add up, per pixel, what every LED's light gains or loses on a slope (see `optics.colour_change`).

    leds (n, 6): cos(elevation) cos(azimuth), cos(elevation) sin(azimuth), sin(elevation), r, g, b.
    strength (n, 3): share of light at the first pixel, its change per pixel to the right and per pixel down.
    """
    rows, cols = gx.shape
    n = leds.shape[0]
    to_x = np.float32(2.0 / cols)
    to_y = np.float32(2.0 / rows)
    for r in range(rows):
        y = (r + np.float32(0.5)) * to_y - np.float32(1.0)
        for c in range(cols):
            sx = gx[r, c]
            sy = gy[r, c]
            red = np.float32(0.0)
            green = np.float32(0.0)
            blue = np.float32(0.0)
            if sx != 0.0 or sy != 0.0:
                x = (c + np.float32(0.5)) * to_x - np.float32(1.0)
                corner = (x * x + y * y) * np.float32(0.5)
                lens = np.float32(1.0) - vignette * corner * corner
                normal = np.float32(1.0) / math.sqrt(np.float32(1.0) + sx * sx + sy * sy)
                for k in range(n):
                    flat = leds[k, 2]
                    facing = (flat - sx * leds[k, 0] - sy * leds[k, 1]) * normal
                    if facing < 0.0:
                        facing = np.float32(0.0)
                    light = lens * (strength[k, 0] + strength[k, 1] * c + strength[k, 2] * r)
                    gain = light * (facing - flat) / (np.float32(1.0) - flat)
                    red += gain * leds[k, 3]
                    green += gain * leds[k, 4]
                    blue += gain * leds[k, 5]
            out[r, c, 0] = red
            out[r, c, 1] = green
            out[r, c, 2] = blue


@njit(cache=True, fastmath=_FAST)
def slopes(height, pixel, gx, gy):
    """d/dx and d/dy of a height by central differences, one-sided at the border."""
    rows, cols = height.shape
    for r in range(rows):
        up = max(r - 1, 0)
        down = min(r + 1, rows - 1)
        per_y = np.float32(1.0) / (np.float32(max(down - up, 1)) * pixel)
        for c in range(cols):
            left = max(c - 1, 0)
            right = min(c + 1, cols - 1)
            gx[r, c] = (height[r, right] - height[r, left]) / (np.float32(max(right - left, 1)) * pixel)
            gy[r, c] = (height[down, c] - height[up, c]) * per_y


@njit(cache=True, fastmath=_FAST)
def print_markers(image, move_x, move_y, pitch, radius, half_twin, darkness):
    """Darken `image` where a marker is; lengths in pixels.

    move_x, move_y (rows, cols): how far the material now seen at a pixel has come from its rest place.
    Dots sit on a square grid with one at the image centre; their edge is one pixel soft.
    """
    rows, cols = move_x.shape
    x0 = np.float32((cols - 1) / 2)
    y0 = np.float32((rows - 1) / 2)
    for r in range(rows):
        for c in range(cols):
            x = (c - x0 - move_x[r, c]) / pitch
            y = (r - y0 - move_y[r, c]) / pitch
            dx = abs(x - math.floor(x + np.float32(0.5))) * pitch - half_twin
            dy = (y - math.floor(y + np.float32(0.5))) * pitch
            cover = radius + np.float32(0.5) - math.sqrt(dx * dx + dy * dy)
            if cover > 0.0:
                share = np.float32(1.0) - darkness * min(cover, np.float32(1.0))
                for k in range(3):
                    image[r, c, k] *= share
