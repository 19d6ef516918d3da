# pyright: basic
"""Compiled loops of the optics: one pass over the image, no temporaries."""

import math

import numpy as np
from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a NaN slope has to stay one


@njit(cache=True, fastmath=_FAST)
def lambert_change(gx, gy, leds, strength, vignette, out):
    """Add to `out`, per pixel, what every LED's light gains or loses on a slope (see `optics.colour_change`).

    leds (n, 6): cos(elevation) cos(azimuth), cos(elevation) sin(azimuth), sin(elevation), r, g, b.
    strength (n, 3): share of light at the first pixel, its change per pixel to the right and per pixel down.
    """
    rows, cols = gx.shape
    one, half = np.float32(1.0), np.float32(0.5)
    to_x, to_y = np.float32(2.0 / cols), np.float32(2.0 / rows)
    # A row at a time, in loops without branches, so that they run on whole vectors of pixels.
    normal, lens = np.empty(cols, np.float32), np.empty(cols, np.float32)
    red, green, blue = np.empty(cols, np.float32), np.empty(cols, np.float32), np.empty(cols, np.float32)
    for r in range(rows):
        y = (np.float32(r) + half) * to_y - one
        row_x, row_y = gx[r], gy[r]
        for c in range(cols):
            x = (np.float32(c) + half) * to_x - one
            corner = (x * x + y * y) * half
            lens[c] = one - vignette * corner * corner
            normal[c] = one / np.sqrt(one + row_x[c] * row_x[c] + row_y[c] * row_y[c])
            red[c] = green[c] = blue[c] = np.float32(0.0)
        for k in range(leds.shape[0]):
            lx, ly, flat = leds[k, 0], leds[k, 1], leds[k, 2]
            at_first = (strength[k, 0] + strength[k, 2] * np.float32(r)) / (one - flat)
            per_col = strength[k, 1] / (one - flat)
            to_red, to_green, to_blue = leds[k, 3], leds[k, 4], leds[k, 5]
            for c in range(cols):
                facing = (flat - row_x[c] * lx - row_y[c] * ly) * normal[c]
                facing = np.float32(0.0) if facing < np.float32(0.0) else facing
                gain = lens[c] * (at_first + per_col * np.float32(c)) * (facing - flat)
                red[c] += gain * to_red
                green[c] += gain * to_green
                blue[c] += gain * to_blue
        for c in range(cols):
            out[r, c, 0] += red[c]
            out[r, c, 1] += green[c]
            out[r, c, 2] += blue[c]


@njit(cache=True, fastmath=_FAST)
def slopes(height, pixel, gx, gy):
    """d/dx and d/dy of a height by central differences, one-sided at the border."""
    rows, cols = height.shape
    per_px = np.float32(1.0) / pixel
    half = np.float32(0.5) * per_px
    for r in range(rows):
        up, down = max(r - 1, 0), min(r + 1, rows - 1)
        per_y = per_px / np.float32(max(down - up, 1))
        here, above, below, to_x, to_y = height[r], height[up], height[down], gx[r], gy[r]
        for c in range(cols):
            to_y[c] = (below[c] - above[c]) * per_y
        for c in range(1, cols - 1):
            to_x[c] = (here[c + 1] - here[c - 1]) * half
        last = cols - 1
        to_x[0] = (here[min(1, last)] - here[0]) * per_px
        to_x[last] = (here[last] - here[max(last - 1, 0)]) * per_px


@njit(cache=True, fastmath=_FAST)
def cast_shadow(height, to_x, to_y, drop, soft, loss, image):
    """Darken `image` behind what stands in the light of one LED: one sweep away from it, O(pixels).

    to_x, to_y: unit vector toward the LED, the sweep's axis being the longer part. drop: how far (mm) the light sinks
    per pixel of its way. soft: by how much (mm) a point must lie below the light to be fully dark. loss (3,): the
    share that a full shadow takes of each colour.
    """
    rows, cols = height.shape
    along_x = abs(to_x) >= abs(to_y)
    n, m = (cols, rows) if along_x else (rows, cols)
    major, minor = (to_x, to_y) if along_x else (to_y, to_x)
    lean = minor / abs(major)
    sink = drop * math.sqrt(np.float32(1.0) + lean * lean)
    edge = np.full(m, np.float32(-1e9), np.float32)  # the height below which the line before lets no light pass
    line = np.empty(m, np.float32)
    for step in range(n):
        i = n - 1 - step if major > 0 else step
        for j in range(m):
            at = j + lean
            first = math.floor(at)
            share = at - first
            low = min(max(first, 0), m - 1)
            high = min(max(first + 1, 0), m - 1)
            here = edge[low] * (np.float32(1.0) - share) + edge[high] * share - sink
            r, c = (j, i) if along_x else (i, j)
            own = height[r, c]
            if here > own:
                cover = min((here - own) / soft, np.float32(1.0))
                for k in range(3):
                    image[r, c, k] *= np.float32(1.0) - cover * loss[k]
                line[j] = here
            else:
                line[j] = own
        edge, line = line, edge


@njit(cache=True, fastmath=_FAST)
def print_markers(image, move_x, move_y, pitch, radius, half_twin, darkness, jitter, place):
    """Darken `image` where a marker is; lengths in pixels.

    move_x, move_y (rows, cols): how far the material now seen at a pixel has come from its rest place.
    place (5,): x and y of the dot nearest the image centre, cosine and sine of the grid's turn, and its bend.
    Dots sit on a square grid, each up to `jitter` off its place; their edge is one pixel soft.
    """
    rows, cols = move_x.shape
    x0 = np.float32((cols - 1) / 2)
    y0 = np.float32((rows - 1) / 2)
    per_corner = place[4] / (x0 * x0 + y0 * y0)
    reach = radius + np.float32(0.5) + jitter
    for r in range(rows):
        for c in range(cols):
            x = c - x0 - move_x[r, c]
            y = r - y0 - move_y[r, c]
            straight = np.float32(1.0) - per_corner * (x * x + y * y)
            x = x * straight - place[0]
            y = y * straight - place[1]
            across = (x * place[2] + y * place[3]) / pitch
            down = (y * place[2] - x * place[3]) / pitch
            i = math.floor(across + np.float32(0.5))
            j = math.floor(down + np.float32(0.5))
            dy = (down - j) * pitch
            if abs(dy) > reach:
                continue
            dx = (across - i) * pitch
            if jitter > 0.0:
                seed = _mixed(np.uint64(np.int64(i) * 7919 + np.int64(j) * 104729 + 12345))
                dx -= jitter * (np.float32(seed & np.uint64(0xFFFF)) / np.float32(32767.5) - np.float32(1.0))
                dy -= jitter * (
                    np.float32((seed >> np.uint64(16)) & np.uint64(0xFFFF)) / np.float32(32767.5) - np.float32(1.0)
                )
            dx = abs(dx) - half_twin
            cover = radius + np.float32(0.5) - math.sqrt(dx * dx + dy * dy)
            if cover > 0.0:
                share = np.float32(1.0) - darkness * min(cover, np.float32(1.0))
                for k in range(3):
                    image[r, c, k] *= share


@njit(cache=True)
def _mixed(n):
    """Sixty-four well-mixed bits of a number (the finaliser of splitmix64)."""
    n = (n ^ (n >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    n = (n ^ (n >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return n ^ (n >> np.uint64(31))


@njit(cache=True, fastmath=_FAST)
def develop(light, gain, quantiles, noise, seed, out):
    """Grey levels of 8 bits: light times gain per colour, plus normal noise of standard deviation `noise`.

    quantiles (4096,): of the standard normal; each pixel's 64 random bits, counted from `seed`, pick three of them.
    """
    rows, cols = light.shape[:2]
    counter = _mixed(seed + np.uint64(0x9E3779B97F4A7C15))
    for r in range(rows):
        for c in range(cols):
            bits = np.uint64(0)
            if noise > 0.0:
                counter += np.uint64(0x9E3779B97F4A7C15)
                bits = _mixed(counter)
            for k in range(3):
                value = light[r, c, k] * gain[k]
                if noise > 0.0:
                    value += noise * quantiles[np.int64(bits & np.uint64(4095))]
                    bits >>= np.uint64(12)
                out[r, c, k] = np.uint8(min(max(value + np.float32(0.5), np.float32(0.0)), np.float32(255.0)))
