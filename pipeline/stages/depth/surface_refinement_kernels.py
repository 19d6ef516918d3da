"""Compiled light of a surface, and the Gauss-Newton step to slopes that explain a picture (`gel_light`).

A part of a row at a time, lamp by lamp, in loops without branches, so that they run on whole vectors of pixels.
"""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import FAST, inline_kernel, kernel
from pipeline.stages.depth.slope_step_kernels import accumulate_normal_equations, solve_slope_step

TILE_PX = 128  # pixels of a row at a time: lines that lie as far apart as the compiler knows are no hindrance to it
_ONE, _TWO, _THREE, _FOUR, _FIVE = (np.uint64(k * TILE_PX) for k in range(1, 6))  # lines behind the first
_COLOURS, _GREEN, _BLUE = np.uint64(3), np.uint64(1), np.uint64(2)


@inline_kernel()
def _strength(strength, led, lens, x, y):
    return lens * (strength[0] + strength[1] * x + strength[2] * y) / (np.float32(1.0) - led[2])


@inline_kernel()
def _lens(x, y, cols, rows, vignette):
    """The share of light that the lens leaves at a pixel of a picture of `cols` x `rows`."""
    one, two, half = np.float32(1.0), np.float32(2.0), np.float32(0.5)
    u, v = (x + half) * two / cols - one, (y + half) * two / rows - one
    corner = (u * u + v * v) * half
    return one - vignette * corner * corner


@inline_kernel()
def _change(more, r, n, light, out):
    still, bright, share = light
    dark = still[r, n]
    out[r, n] = (dark + more * bright[r, n]) * share[r, n] - dark


@kernel(fastmath=FAST)
def render_pixels(gx, gy, place, light, line, out):
    """Write to `out` (rows, 3 cols) what slopes gx, gy change of the untouched picture, shadows and all.

    place: x (cols,) and y (rows,), places in the picture; its size (cols, rows) in pixels; the lamps, their strength as
    `optics.lamps` has them, and the vignette. light, each (rows, 3 cols): the untouched picture, by how much the
    unit's own light is stronger than described, and the share of it that gets there. line (3 x TILE,): written over.
    """
    x, y, size, leds, strength, vignette = place
    rows, cols = gx.shape
    one, nothing = np.float32(1.0), np.float32(0.0)
    for row in range(rows):
        r = np.uint64(row)
        for start in range(0, cols, TILE_PX):
            n, first = min(TILE_PX, cols - start), np.uint64(start)
            line[:] = nothing
            for lamp in range(leds.shape[0]):
                led = leds[lamp]
                for i in range(n):
                    t, c = np.uint64(i), np.uint64(i) + first
                    sx, sy = gx[r, c], gy[r, c]
                    slant = one / np.sqrt(one + sx * sx + sy * sy)
                    facing = (led[2] - sx * led[0] - sy * led[1]) * slant
                    gain = (facing if facing > nothing else nothing) - led[2]
                    gain *= _strength(strength[lamp], led, _lens(x[c], y[r], size[0], size[1], vignette), x[c], y[r])
                    line[t] += gain * led[3]
                    line[t + _ONE] += gain * led[4]
                    line[t + _TWO] += gain * led[5]
            for i in range(n):
                t, c = np.uint64(i), np.uint64(i) + first
                _change(line[t], r, _COLOURS * c, light, out)
                _change(line[t + _ONE], r, _COLOURS * c + _GREEN, light, out)
                _change(line[t + _TWO], r, _COLOURS * c + _BLUE, light, out)


@kernel(fastmath=FAST)
def update_slopes(rest, change, moved, place, light, limits, line, gx, gy, sure):
    """Add to the slopes gx, gy of every pixel of `moved` the step that best explains `rest`; zero them elsewhere.

    rest, change (rows, 3 cols): what the rendered change lacks, and the change seen, in grey levels; place and light
    as in `lit`. limits: a pull that holds every step back, a misfit beyond which none pulls harder, the steepest
    slope, and how sure a level pixel outside is. line (6 x TILE,): written over. sure (rows, 3 cols): written to, how
    surely each pixel tells its slopes, the matrix (xx, xy, yy). Returns the sum of what was left before the step, each
    no larger than twice the second limit.
    """
    x, y, size, leds, strength, vignette = place
    still, bright, share = light
    pull, huber, steepest, outside = limits
    rows, cols = moved.shape
    one, nothing, misfit = np.float32(1.0), np.float32(0.0), 0.0
    for row in range(rows):
        r = np.uint64(row)
        for start in range(0, cols, TILE_PX):
            n, first = min(TILE_PX, cols - start), np.uint64(start)
            line[:] = nothing
            for lamp in range(leds.shape[0]):
                led = leds[lamp]
                for i in range(n):
                    t, c = np.uint64(i), np.uint64(i) + first
                    sx, sy = gx[r, c], gy[r, c]
                    slant = one / np.sqrt(one + sx * sx + sy * sy)
                    facing = (led[2] - sx * led[0] - sy * led[1]) * slant
                    bent = facing * slant * slant
                    weight = _strength(strength[lamp], led, _lens(x[c], y[r], size[0], size[1], vignette), x[c], y[r])
                    weight = weight if facing > nothing else nothing
                    across, down = (-led[0] * slant - bent * sx) * weight, (-led[1] * slant - bent * sy) * weight
                    line[t] += across * led[3]
                    line[t + _ONE] += across * led[4]
                    line[t + _TWO] += across * led[5]
                    line[t + _THREE] += down * led[3]
                    line[t + _FOUR] += down * led[4]
                    line[t + _FIVE] += down * led[5]
            for i in range(n):
                t, c = np.uint64(i), np.uint64(i) + first
                red, green, blue = _COLOURS * c, _COLOURS * c + _GREEN, _COLOURS * c + _BLUE
                sums, by = (pull, nothing, pull, nothing, nothing, nothing), bright[r, red] * share[r, red]
                seen = still[r, red] + change[r, red]
                sums = accumulate_normal_equations(sums, line[t] * by, line[t + _THREE] * by, rest[r, red], seen, huber)
                by, seen = bright[r, green] * share[r, green], still[r, green] + change[r, green]
                sums = accumulate_normal_equations(
                    sums, line[t + _ONE] * by, line[t + _FOUR] * by, rest[r, green], seen, huber
                )
                by, seen = bright[r, blue] * share[r, blue], still[r, blue] + change[r, blue]
                sums = accumulate_normal_equations(
                    sums, line[t + _TWO] * by, line[t + _FIVE] * by, rest[r, blue], seen, huber
                )
                line[t], line[t + _ONE], line[t + _TWO], line[t + _THREE], line[t + _FOUR], line[t + _FIVE] = sums
            for i in range(n):
                t, c = np.uint64(i), np.uint64(i) + first
                here = moved[r, c]
                sure[r, _COLOURS * c] = line[t] if here else outside
                sure[r, _COLOURS * c + _GREEN] = line[t + _ONE] if here else nothing
                sure[r, _COLOURS * c + _BLUE] = line[t + _TWO] if here else outside
            total = nothing
            for i in range(n):
                t, c = np.uint64(i), np.uint64(i) + first
                here = moved[r, c]
                sums = (line[t], line[t + _ONE], line[t + _TWO], line[t + _THREE], line[t + _FOUR], line[t + _FIVE])
                to_x, to_y = solve_slope_step(gx[r, c], gy[r, c], sums, steepest)
                gx[r, c], gy[r, c] = to_x if here else nothing, to_y if here else nothing
                total += sums[5] if here else nothing
            misfit += total
    return misfit
