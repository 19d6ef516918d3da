"""Compiled light of lamps that dents hide, and the step to slopes that explain a picture (`cast_light`)."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import FAST, inline_kernel, kernel
from pipeline.stages.depth.slope_step_kernels import accumulate_normal_equations, solve_slope_step


@inline_kernel()
def _slant(sx, sy):
    one = np.float32(1.0)
    return one / np.sqrt(one + sx * sx + sy * sy)


@kernel(fastmath=FAST)
def render_pixels(gx, gy, level, seen, leds, share, out):
    """Write to `out` (rows, cols, 3) the grey levels that slopes gx, gy and what stands before the lamps change.

    level (rows, cols, 3): the light on level ground; seen (n, rows, cols): the share of each lamp that gets there;
    lamps (n, 3): unit vectors toward them; share (3, n): theirs of every colour's light on level ground.
    """
    rows, cols = gx.shape
    one, nothing = np.float32(1.0), np.float32(0.0)
    for r in range(rows):
        for c in range(cols):
            sx, sy = gx[r, c], gy[r, c]
            slant = _slant(sx, sy)
            red, green, blue = nothing, nothing, nothing
            for n in range(leds.shape[0]):
                facing = (leds[n, 2] - sx * leds[n, 0] - sy * leds[n, 1]) * slant / leds[n, 2]
                more = (facing if facing > nothing else nothing) * seen[n, r, c] - one
                red += share[0, n] * more
                green += share[1, n] * more
                blue += share[2, n] * more
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = (
                red * level[r, c, 0],
                green * level[r, c, 1],
                blue * level[r, c, 2],
            )


@kernel(fastmath=FAST)
def update_slopes(rest, drawn, certain, moved, level, seen, leds, share, limits, gx, gy, sure):
    """Add to the slopes gx, gy of every pixel of `moved` the step that best explains `rest`; zero them elsewhere.

    rest, drawn, certain (rows, cols, 3): what the rendered change lacks and what the camera sees, in grey levels, and
    how much each colour counts; the others as in `lit`. limits: a pull that holds every step back, a misfit beyond
    which none pulls harder, the steepest slope, and how sure a level pixel outside is. sure (rows, cols, 3): written
    to, how surely each pixel tells its slopes, the matrix (xx, xy, yy). Returns the sum of what was left before the
    step, each no larger than twice the second limit.
    """
    pull, huber, steepest, outside = limits
    rows, cols = moved.shape
    nothing, misfit = np.float32(0.0), 0.0
    for r in range(rows):
        for c in range(cols):
            if not moved[r, c]:
                gx[r, c] = gy[r, c] = sure[r, c, 1] = nothing
                sure[r, c, 0] = sure[r, c, 2] = outside
                continue
            sx, sy = gx[r, c], gy[r, c]
            slant = _slant(sx, sy)
            sums = (pull, nothing, pull, nothing, nothing, nothing)
            for k in range(3):
                across, down = nothing, nothing
                for n in range(leds.shape[0]):
                    facing = (leds[n, 2] - sx * leds[n, 0] - sy * leds[n, 1]) * slant
                    if facing > nothing:
                        bent, by = facing * slant * slant, share[k, n] * seen[n, r, c] / leds[n, 2]
                        across -= (leds[n, 0] * slant + bent * sx) * by
                        down -= (leds[n, 1] * slant + bent * sy) * by
                by = level[r, c, k] * certain[r, c, k]
                sums = accumulate_normal_equations(
                    sums, across * by, down * by, rest[r, c, k] * certain[r, c, k], drawn[r, c, k], huber
                )
            sure[r, c, 0], sure[r, c, 1], sure[r, c, 2] = sums[0], sums[1], sums[2]
            misfit += sums[5]
            gx[r, c], gy[r, c] = solve_slope_step(sx, sy, sums, steepest)
    return misfit
