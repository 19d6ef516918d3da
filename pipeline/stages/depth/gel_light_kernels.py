"""Compiled light of a surface, and the Gauss-Newton step to slopes that explain a picture (`gel_light`)."""
# pyright: basic

import numpy as np

from pipeline.base.kept_kernels import FAST, inlined, kernel
from pipeline.stages.depth.slope_step_kernels import added, stepped, weighed


@inlined()
def _facing(led, sx, sy, slant):
    """How much a lamp's light grows on a slope, and its rates with both slopes; `slant` is 1 / sqrt(1 + slope^2)."""
    nothing = np.float32(0.0)
    facing = (led[2] - sx * led[0] - sy * led[1]) * slant
    if facing <= nothing:
        return -led[2], nothing, nothing
    bent = facing * slant * slant
    return facing - led[2], -led[0] * slant - bent * sx, -led[1] * slant - bent * sy


@inlined()
def _strength(strength, led, lens, x, y):
    return lens * (strength[0] + strength[1] * x + strength[2] * y) / (np.float32(1.0) - led[2])


@inlined()
def _lens(x, y, cols, rows, vignette):
    """The share of light that the lens leaves at a pixel of a picture of `cols` x `rows`."""
    one, two, half = np.float32(1.0), np.float32(2.0), np.float32(0.5)
    u, v = (x + half) * two / cols - one, (y + half) * two / rows - one
    corner = (u * u + v * v) * half
    return one - vignette * corner * corner


@kernel(fastmath=FAST)
def lit(gx, gy, place, light, out):
    """Write to `out` (rows, cols, 3) what slopes gx, gy change of the untouched picture, shadows and all.

    place: x (cols,) and y (rows,), places in the picture; its size (cols, rows) in pixels; the lamps, their strength as
    `optics.lamps` has them, and the vignette. light, each (rows, cols, 3): the untouched picture, by how much the
    unit's own light is stronger than described, and the share of it that gets there.
    """
    x, y, size, leds, strength, vignette = place
    still, bright, share = light
    rows, cols = gx.shape
    one = np.float32(1.0)
    for r in range(rows):
        for c in range(cols):
            sx, sy = gx[r, c], gy[r, c]
            slant = one / np.sqrt(one + sx * sx + sy * sy)
            lens = _lens(x[c], y[r], size[0], size[1], vignette)
            red = green = blue = np.float32(0.0)
            for k in range(leds.shape[0]):
                gain, _, _ = _facing(leds[k], sx, sy, slant)
                gain *= _strength(strength[k], leds[k], lens, x[c], y[r])
                red += gain * leds[k, 3]
                green += gain * leds[k, 4]
                blue += gain * leds[k, 5]
            out[r, c, 0] = (still[r, c, 0] + red * bright[r, c, 0]) * share[r, c, 0] - still[r, c, 0]
            out[r, c, 1] = (still[r, c, 1] + green * bright[r, c, 1]) * share[r, c, 1] - still[r, c, 1]
            out[r, c, 2] = (still[r, c, 2] + blue * bright[r, c, 2]) * share[r, c, 2] - still[r, c, 2]


@kernel(fastmath=FAST)
def explained(rest, change, moved, place, light, limits, by, gx, gy, sure):
    """Add to the slopes gx, gy of every pixel of `moved` the step that best explains `rest`; zero them elsewhere.

    rest, change (rows, cols, 3): what the rendered change lacks, and the change seen, in grey levels; place and light
    as in `lit`. limits: a pull that holds every step back, a misfit beyond which none pulls harder, the steepest
    slope, and how sure a level pixel outside is. by (2, 3): written over. sure (rows, cols, 3): written to, how surely
    each pixel tells its slopes, the matrix (xx, xy, yy). Returns the sum of what was left before the step, each no
    larger than twice the second limit.
    """
    x, y, size, leds, strength, vignette = place
    still, bright, share = light
    pull, huber, steepest, outside = limits
    rows, cols = moved.shape
    one, two, nothing, misfit = np.float32(1.0), np.float32(2.0), np.float32(0.0), 0.0
    for r in range(rows):
        for c in range(cols):
            if not moved[r, c]:
                gx[r, c] = gy[r, c] = nothing
                sure[r, c, 0], sure[r, c, 1], sure[r, c, 2] = outside, nothing, outside
                continue
            sx, sy = gx[r, c], gy[r, c]
            slant = one / np.sqrt(one + sx * sx + sy * sy)
            lens = _lens(x[c], y[r], size[0], size[1], vignette)
            for k in range(3):
                by[0, k] = by[1, k] = nothing
            for n in range(leds.shape[0]):
                _, across, down = _facing(leds[n], sx, sy, slant)
                weight = _strength(strength[n], leds[n], lens, x[c], y[r])
                for k in range(3):
                    by[0, k] += across * weight * leds[n, 3 + k]
                    by[1, k] += down * weight * leds[n, 3 + k]
            sums = (pull, nothing, pull, nothing, nothing)
            for k in range(3):
                off = rest[r, c, k]
                weight = weighed(off, still[r, c, k] + change[r, c, k], huber)
                if weight > nothing:
                    here = bright[r, c, k] * share[r, c, k]
                    sums = added(sums, by[0, k] * here, by[1, k] * here, off, weight)
                    misfit += min(abs(off), two * huber)
            sure[r, c, 0], sure[r, c, 1], sure[r, c, 2] = sums[0], sums[1], sums[2]
            gx[r, c], gy[r, c] = stepped(sx, sy, sums, steepest)
    return misfit
