# pyright: basic
"""Compiled loops of the optics: one pass over the image, without temporaries."""

import math

import numpy as np

from pipeline.core.cached_kernels import FAST, inline_kernel, kernel
from pipeline.physics.slope_kernels import write_row_slopes

# Called functions are inlined before compilation: as separate functions, with contracted sums,
# their results differ in the last bit between a process that compiles them and one that loads them
# from the cache. No arcp: processors with a fast estimate of 1 / sqrt would use it, and zero
# slopes, where the root is 1, would change the light slightly.
_FAST = FAST - {"arcp"}


@kernel(fastmath=_FAST)
def render_light(height, pixel, leds, strength, vignette, light):
    """Add to the reference `light` (rows, 3 cols) of a surface the change by its slopes."""
    rows, cols = height.shape
    gx = np.empty(cols, np.float32)
    gy = np.empty(cols, np.float32)
    part = np.empty(3 * cols, np.float32)
    change = np.empty(3 * cols, np.float32)
    for r in range(rows):
        write_row_slopes(height, r, np.float32(1.0) / pixel, gx, gy)
        _row_change(gx, gy, r, rows, leds, strength, vignette, part, change)
        _add(change, light[r])


@inline_kernel()
def _row_change(gx, gy, r, rows, leds, strength, vignette, part, out):
    """Write the change by all LEDs in row `r`, three at a time: `out` (3 cols,), interleaved
    colours.
    """
    y = (np.float32(r) + np.float32(0.5)) * np.float32(2.0 / rows) - np.float32(1.0)
    to_x = np.float32(2.0 / gx.shape[0])
    for k in range(0, leds.shape[0], 3):
        one = _get_led(leds[k], strength[k], r)
        two = _get_led(leds[k + 1], strength[k + 1], r)
        three = _get_led(leds[k + 2], strength[k + 2], r)
        _row_of_three(gx, gy, y, to_x, vignette, one, two, three, out if k == 0 else part)
        if k > 0:
            _add(part, out)


@inline_kernel()
def _get_led(led, strength, r):
    """Direction (3), its share of light at the row's first pixel, the share's change per pixel,
    colour (3).
    """
    per_flat = np.float32(1.0) - led[2]
    first = (strength[0] + strength[2] * np.float32(r)) / per_flat
    return led[0], led[1], led[2], first, strength[1] / per_flat, led[3], led[4], led[5]


# Inner loops are vectorised: no branches, and unsigned indices, since a negative index counts from
# the end and would be checked at every pixel.


@inline_kernel()
def _row_of_three(gx, gy, y, to_x, vignette, one, two, three, out):
    third = np.uint64(3)
    next_one = np.uint64(1)
    nothing = np.float32(0.0)
    unit = np.float32(1.0)
    half = np.float32(0.5)
    ax, ay, az, a_first, a_per, a_red, a_green, a_blue = one
    bx, by, bz, b_first, b_per, b_red, b_green, b_blue = two
    cx, cy, cz, c_first, c_per, c_red, c_green, c_blue = three
    for i in range(gx.shape[0]):
        c = np.uint64(i)
        sx = gx[c]
        sy = gy[c]
        at = np.float32(np.int32(i))
        x = (at + half) * to_x - unit
        corner = (x * x + y * y) * half
        lens = unit - vignette * corner * corner
        normal = unit / np.sqrt(unit + sx * sx + sy * sy)
        facing = (az - sx * ax - sy * ay) * normal
        a = lens * (a_first + a_per * at) * ((nothing if facing < nothing else facing) - az)
        facing = (bz - sx * bx - sy * by) * normal
        b = lens * (b_first + b_per * at) * ((nothing if facing < nothing else facing) - bz)
        facing = (cz - sx * cx - sy * cy) * normal
        d = lens * (c_first + c_per * at) * ((nothing if facing < nothing else facing) - cz)
        out[third * c] = a * a_red + b * b_red + d * c_red
        out[third * c + next_one] = a * a_green + b * b_green + d * c_green
        out[third * c + next_one + next_one] = a * a_blue + b * b_blue + d * c_blue


@inline_kernel()
def _add(more, out):
    for i in range(out.shape[0]):
        n = np.uint64(i)
        out[n] += more[n]


@kernel(fastmath=_FAST)
def cast_shadow(height, to_x, to_y, drop, soft, lines, cover):
    """Write the blocked share of one LED's light, `cover` (rows, cols) from 0 to 1.

    One sweep away from the LED, O(pixels), a row at a time; requires |to_y| >= |to_x| (transpose
    the image otherwise). to_x, to_y: unit vector toward the LED. drop: descent of the light in mm
    per pixel of path. soft: depth in mm below the light at which a point is fully dark. lines (2,
    cols + 4): buffer.
    """
    rows, cols = height.shape
    lean = to_x / abs(to_y)
    sink = drop * np.sqrt(np.float32(1.0) + lean * lean)
    first = math.floor(lean)
    share = np.float32(lean - np.float32(first))
    # Height of the light above the previous row, with two more values at either end.
    lines[0] = np.float32(-1e9)
    for step in range(rows):
        r = rows - 1 - step if to_y > 0 else step
        edge = lines[step % 2]
        line = lines[(step + 1) % 2]
        _shade_row(
            edge[2 + first :], edge[3 + first :], share, sink, soft, height[r], line[2:-2], cover[r]
        )
        line[0] = line[1] = line[2]
        line[cols + 2] = line[cols + 3] = line[cols + 1]


@inline_kernel()
def _shade_row(low, high, share, sink, soft, height, line, cover):
    nothing = np.float32(0.0)
    one = np.float32(1.0)
    per_soft = one / soft
    for i in range(height.shape[0]):
        c = np.uint64(i)
        light = low[c] * (one - share) + high[c] * share - sink
        own = height[c]
        depth = (light - own) * per_soft
        cover[c] = min(max(depth, nothing), one)
        line[c] = light if light > own else own


@kernel(fastmath=_FAST)
def darken(image, cover, loss):
    """Reduce each colour of `image` (rows, cols, 3) by the share `loss` (3,) times `cover`
    (rows, cols).
    """
    rows, cols = cover.shape
    flat = image.reshape(rows, 3 * cols)
    for r in range(rows):
        _darken_row(flat[r], cover[r], loss[0], loss[1], loss[2])


@inline_kernel()
def _darken_row(out, cover, red, green, blue):
    three = np.uint64(3)
    one = np.uint64(1)
    whole = np.float32(1.0)
    for i in range(cover.shape[0]):
        c = np.uint64(i)
        dark = cover[c]
        out[three * c] *= whole - dark * red
        out[three * c + one] *= whole - dark * green
        out[three * c + one + one] *= whole - dark * blue


@kernel(fastmath=_FAST)
def darken_markers(image, move_x, move_y, pitch, radius, half_twin, darkness, jitter, place):
    """Darken `image` at the markers; lengths in pixels.

    move_x, move_y (rows, cols): motion of the material at each pixel from its rest position. place
    (5,): x and y of the dot nearest the image centre, cosine and sine of the grid's rotation, and
    its distortion. Dots are on a square grid, each displaced by up to `jitter`; their edge is one
    pixel soft.
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
                seed = _mix_bits(np.uint64(np.int64(i) * 7919 + np.int64(j) * 104729 + 12345))
                dx -= jitter * (
                    np.float32(seed & np.uint64(0xFFFF)) / np.float32(32767.5) - np.float32(1.0)
                )
                dy -= jitter * (
                    np.float32((seed >> np.uint64(16)) & np.uint64(0xFFFF)) / np.float32(32767.5)
                    - np.float32(1.0)
                )
            dx = abs(dx) - half_twin
            cover = radius + np.float32(0.5) - math.sqrt(dx * dx + dy * dy)
            if cover > 0.0:
                share = np.float32(1.0) - darkness * min(cover, np.float32(1.0))
                for k in range(3):
                    image[r, c, k] *= share


@inline_kernel()
def _mix_bits(n):
    """Sixty-four mixed bits of a number (the finaliser of splitmix64)."""
    n = (n ^ (n >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    n = (n ^ (n >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return n ^ (n >> np.uint64(31))


@kernel(fastmath=_FAST)
def digitise(light, quantiles, noise, seed, out):
    """Write 8-bit grey levels: the light plus normal noise of standard deviation `noise`.

    quantiles (4096,): of the standard normal; 64 random bits of each pixel, counted from `seed`,
    select three of them.
    """
    rows, cols = light.shape[:2]
    counter = _mix_bits(seed + np.uint64(0x9E3779B97F4A7C15))
    for r in range(rows):
        for c in range(cols):
            counter += np.uint64(0x9E3779B97F4A7C15)
            bits = _mix_bits(counter)
            for k in range(3):
                value = light[r, c, k] + noise * quantiles[np.int64(bits & np.uint64(4095))]
                bits >>= np.uint64(12)
                out[r, c, k] = np.uint8(
                    min(max(value + np.float32(0.5), np.float32(0.0)), np.float32(255.0))
                )
