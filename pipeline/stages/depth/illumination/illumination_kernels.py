"""Compiled rendering of the three light models, with derivatives, and the Gauss-Newton step of the
slopes, and the normal equations of the shapes by which a surface is moved as a whole.

Colour images (rows, cols, 3) are read as (rows, 3 cols) where that is faster: a stride that the
compiler does not know is slow. `change` is in grey levels; `rate_x` and `rate_y` are its
derivatives by the slopes gx and gy (grey levels per mm/mm).
"""
# pyright: basic

import math

import numpy as np

from pipeline.core.cached_kernels import FAST, inline_kernel, kernel
from pipeline.physics.slope_kernels import write_row_slopes

# pixels of a row that are processed together, so that loops without branches are vectorised
TILE_PX = 128
N_LINES = 9  # scratch lines of a tile
_LINE = tuple(np.uint64(k * TILE_PX) for k in range(N_LINES))
_L1, _L2, _L3, _L4, _L5, _L6, _L7, _L8 = _LINE[1:]
_COLOURS = np.uint64(3)
# the camera carries no information beyond
_MIN_GREY = np.float32(0.5)
_MAX_GREY = np.float32(254.0)
_NOISE_GREY = np.float32(1.5)
_MAX_STEP = np.float32(0.3)  # mm/mm: the light is linear in the slope for about that far
_TINY = np.float32(1e-20)  # a fast reciprocal root of 0 is not finite


@inline_kernel()
def _lens_share(x, y, cols, rows, vignette):
    one = np.float32(1.0)
    two = np.float32(2.0)
    half = np.float32(0.5)
    u = (x + half) * two / cols - one
    v = (y + half) * two / rows - one
    corner = (u * u + v * v) * half
    return one - vignette * corner * corner


@kernel(fastmath=FAST)
def render_led_light(gx, gy, place, light, line, change, rate_x, rate_y):
    """Render slopes in the light of distant LEDs.

    place: x (cols,) and y (rows,) in the image; its size (cols, rows) in pixels; the LEDs and their
    strength as `optics.pack_leds` has them; the vignette. light, each (rows, cols, 3): the
    reference image, the gain of the instance's light over the described one, and the share of light
    that no dent blocks. line (9 TILE,): scratch.
    """
    x, y, size, leds, strength, vignette = place
    rows, cols = gx.shape
    flat = (rows, 3 * cols)
    reference = light[0].reshape(flat)
    gain = light[1].reshape(flat)
    share = light[2].reshape(flat)
    change = change.reshape(flat)
    rate_x = rate_x.reshape(flat)
    rate_y = rate_y.reshape(flat)
    one = np.float32(1.0)
    zero = np.float32(0.0)
    for row in range(rows):
        r = np.uint64(row)
        for start in range(0, cols, TILE_PX):
            n = min(TILE_PX, cols - start)
            first = np.uint64(start)
            line[:] = zero
            for number in range(leds.shape[0]):
                led = leds[number]
                power = strength[number]
                for i in range(n):
                    t = np.uint64(i)
                    c = np.uint64(i) + first
                    sx = gx[r, c]
                    sy = gy[r, c]
                    slant = one / np.sqrt(one + sx * sx + sy * sy)
                    facing = (led[2] - sx * led[0] - sy * led[1]) * slant
                    lens = _lens_share(x[c], y[r], size[0], size[1], vignette)
                    weight = lens * (power[0] + power[1] * x[c] + power[2] * y[r]) / (one - led[2])
                    more = ((facing if facing > zero else zero) - led[2]) * weight
                    bent = facing * slant * slant
                    weight = weight if facing > zero else zero
                    across = (-led[0] * slant - bent * sx) * weight
                    down = (-led[1] * slant - bent * sy) * weight
                    line[t] += more * led[3]
                    line[t + _L1] += more * led[4]
                    line[t + _L2] += more * led[5]
                    line[t + _L3] += across * led[3]
                    line[t + _L4] += across * led[4]
                    line[t + _L5] += across * led[5]
                    line[t + _L6] += down * led[3]
                    line[t + _L7] += down * led[4]
                    line[t + _L8] += down * led[5]
            for k in range(3):
                more_at = np.uint64(k * TILE_PX)
                for i in range(n):
                    t = np.uint64(i) + more_at
                    c = _COLOURS * (np.uint64(i) + first) + np.uint64(k)
                    by = gain[r, c] * share[r, c]
                    change[r, c] = reference[r, c] * (share[r, c] - one) + line[t] * by
                    rate_x[r, c] = line[t + _L3] * by
                    rate_y[r, c] = line[t + _L6] * by


@kernel(fastmath=FAST)
def render_field_light(gx, gy, surface_mm, field, change, rate_x, rate_y):
    """Render slopes and indentations in a shading field.

    field (rows, cols, 3, 4): grey levels of each colour per unit of the normal's x, y and z, and
    per mm.
    """
    rows, cols = gx.shape
    one = np.float32(1.0)
    for r in range(rows):
        for c in range(cols):
            sx = gx[r, c]
            sy = gy[r, c]
            slant = one / np.sqrt(one + sx * sx + sy * sy)
            bent = slant * slant * slant
            for k in range(3):
                a = field[r, c, k]
                change[r, c, k] = (
                    -(a[0] * sx + a[1] * sy) * slant
                    + a[2] * (slant - one)
                    + a[3] * surface_mm[r, c]
                )
                along = (a[0] * sx + a[1] * sy - a[2]) * bent
                rate_x[r, c, k] = along * sx - a[0] * slant
                rate_y[r, c, k] = along * sy - a[1] * slant


@kernel(fastmath=FAST)
def sum_field_products(u, v, gx, gy, surface_mm, change, seen, line, sums):
    """Add up the products of a shading field's normal equations; return (squared change, cells).

    For every power of v and of u: the products of two of the four shading terms, and of each colour
    with them, in `sums` (powers, powers, 4 + 3, 4), zeros before. u (cols,), v (rows,): positions;
    gx, gy, surface_mm, seen (rows, cols); change (rows, cols, 3); line (4 + 3 + 28, cols): scratch.
    """
    rows, cols = gx.shape
    n = sums.shape[0]
    one = np.float32(1.0)
    energy = 0.0
    count = 0
    for r in range(rows):
        for i in range(cols):
            c = np.uint64(i)
            here = one if seen[r, c] else np.float32(0.0)
            sx = gx[r, c]
            sy = gy[r, c]
            slant = one / np.sqrt(one + sx * sx + sy * sy)
            line[0, c] = -sx * slant * here
            line[1, c] = -sy * slant * here
            line[2, c] = (slant - one) * here
            line[3, c] = surface_mm[r, c] * here
            line[4, c] = change[r, c, 0] * here
            line[5, c] = change[r, c, 1] * here
            line[6, c] = change[r, c, 2] * here
            energy += line[4, c] ** 2 + line[5, c] ** 2 + line[6, c] ** 2
            count += seen[r, c]
        for a in range(7):
            for b in range(4):
                product = line[7 + 4 * a + b]
                for i in range(cols):
                    product[i] = line[a, i] * line[b, i]
                for k in range(n):
                    total = np.float32(0.0)
                    for i in range(cols):
                        total += product[i]
                        product[i] *= u[i]
                    power = 1.0
                    for j in range(n - k):
                        sums[j, k, a, b] += power * total
                        power *= v[r]
    return energy, count


@inline_kernel()
def _accumulate(sums, confidence, jx, jy, rendered, change, reference, huber):
    """Add one colour to the normal equations (xx, xy, yy, to x, to y) and to the misfit.

    None where it is clipped.
    """
    xx, xy, yy, to_x, to_y, misfit = sums
    one = np.float32(1.0)
    zero = np.float32(0.0)
    observed = reference + change
    residual = observed - min(max(rendered + reference, zero), np.float32(255.0))
    jx = jx * confidence
    jy = jy * confidence
    residual = residual * confidence
    rendered = observed - residual
    size = abs(residual)
    informative = (rendered >= _MIN_GREY or observed >= _MIN_GREY + _NOISE_GREY) and (
        rendered <= _MAX_GREY or observed <= _MAX_GREY - _NOISE_GREY
    )
    weight = min(one, huber / max(size, np.float32(1e-6))) if informative else zero
    misfit += min(size, huber + huber) if informative else zero
    wx = weight * jx
    wy = weight * jy
    return (
        xx + wx * jx,
        xy + wx * jy,
        yy + wy * jy,
        to_x + wx * residual,
        to_y + wy * residual,
        misfit,
    )


@inline_kernel()
def _step(sx, sy, sums, max_slope):
    """The slopes after the step that solves the normal equations, limited in its length and in
    the slope.
    """
    one = np.float32(1.0)
    xx, xy, yy, to_x, to_y, _ = sums
    per = one / (xx * yy - xy * xy)
    step_x = (yy * to_x - xy * to_y) * per
    step_y = (xx * to_y - xy * to_x) * per
    cut = min(one, _MAX_STEP / math.sqrt(step_x * step_x + step_y * step_y + _TINY))
    to_x = sx + step_x * cut
    to_y = sy + step_y * cut
    cut = min(one, max_slope / math.sqrt(to_x * to_x + to_y * to_y + _TINY))
    return to_x * cut, to_y * cut


@kernel(fastmath=FAST)
def update_slopes(
    rendered, recorded, confidence, changed, rate_x, rate_y, limits, line, gx, gy, weights
):
    """Add the Gauss-Newton step to the slopes gx, gy of each changed pixel, zero them elsewhere.

    Return the misfit.

    rendered (rows, cols, 3): the change that the surface shows, in grey levels, before the camera
    clips it; recorded: the recorded change and the reference image, each alike; confidence (rows,
    cols, 3): weight of each colour. limits: pull and steepest slope of
    `StepRule`, Huber limit between them, outside weight last. line (9 TILE,): scratch. weights (3,
    rows, cols) is written: the information matrix (xx, xy, yy) of each pixel's slopes. The misfit
    sums the absolute residuals before the step, each at most twice the Huber limit.
    """
    pull, huber, max_slope, outside = limits
    rows, cols = changed.shape
    flat = (rows, 3 * cols)
    rendered = rendered.reshape(flat)
    confidence = confidence.reshape(flat)
    change = recorded[0].reshape(flat)
    reference = recorded[1].reshape(flat)
    rate_x = rate_x.reshape(flat)
    rate_y = rate_y.reshape(flat)
    zero = np.float32(0.0)
    misfit = 0.0
    for row in range(rows):
        r = np.uint64(row)
        for start in range(0, cols, TILE_PX):
            n = min(TILE_PX, cols - start)
            first = np.uint64(start)
            for i in range(n):
                t = np.uint64(i)
                first_colour = _COLOURS * (np.uint64(i) + first)
                sums = (pull, zero, pull, zero, zero, zero)
                for k in range(first_colour, first_colour + _COLOURS):
                    sums = _accumulate(
                        sums,
                        confidence[r, k],
                        rate_x[r, k],
                        rate_y[r, k],
                        rendered[r, k],
                        change[r, k],
                        reference[r, k],
                        huber,
                    )
                (
                    line[t],
                    line[t + _L1],
                    line[t + _L2],
                    line[t + _L3],
                    line[t + _L4],
                    line[t + _L5],
                ) = sums
            total = zero
            for i in range(n):
                t = np.uint64(i)
                c = np.uint64(i) + first
                here = changed[r, c]
                weights[0, r, c] = line[t] if here else outside
                weights[1, r, c] = line[t + _L1] if here else zero
                weights[2, r, c] = line[t + _L2] if here else outside
                sums = (
                    line[t],
                    line[t + _L1],
                    line[t + _L2],
                    line[t + _L3],
                    line[t + _L4],
                    line[t + _L5],
                )
                to_x, to_y = _step(gx[r, c], gy[r, c], sums, max_slope)
                gx[r, c] = to_x if here else zero
                gy[r, c] = to_y if here else zero
                total += sums[5] if here else zero
            misfit += total
    return misfit


@kernel(fastmath=FAST)
def accumulate_normal_equations(
    surface_mm, per_px, ramps, target_x, target_y, weights, lines, normal, pull
):
    """Write the normal equations of the sum of shapes that brings the surface's slopes to the
    target slopes.

    ramps (n, 4): factor, offset, lowest and highest value of the shapes that a surface (rows, cols)
    makes; the first is the surface itself. weights (3, rows, cols): the information matrix (xx, xy,
    yy) of each pixel's slopes. normal (n, n) and pull (n,) are doubles: the weighted slopes of one
    shape times those of another, and times the residual. lines (n + 1, 5, cols): scratch.
    """
    n = ramps.shape[0]
    rows, cols = surface_mm.shape
    weighted = lines[n]
    normal[:] = 0.0
    pull[:] = 0.0
    for row in range(rows):
        r = np.uint64(row)
        above = max(row - 1, 0)
        below = min(row + 2, rows)
        for a in range(n):
            heights = lines[a, : below - above]
            for k in range(above, below):
                _make_shape(surface_mm[k], ramps[a], heights[k - above])
            write_row_slopes(heights, row - above, per_px, lines[a, 3], lines[a, 4])
        for a in range(n):
            total = np.float32(0.0)
            for i in range(cols):
                c = np.uint64(i)
                x = weights[0, r, c] * lines[a, 3, c] + weights[1, r, c] * lines[a, 4, c]
                y = weights[1, r, c] * lines[a, 3, c] + weights[2, r, c] * lines[a, 4, c]
                weighted[0, c] = x
                weighted[1, c] = y
                total += x * (target_x[r, c] - lines[0, 3, c]) + y * (
                    target_y[r, c] - lines[0, 4, c]
                )
            pull[a] += total
            for b in range(a + 1):
                total = np.float32(0.0)
                for i in range(cols):
                    c = np.uint64(i)
                    total += weighted[0, c] * lines[b, 3, c] + weighted[1, c] * lines[b, 4, c]
                normal[a, b] += total
    for a in range(n):
        for b in range(a):
            normal[b, a] = normal[a, b]


@inline_kernel()
def _make_shape(heights, ramp, out):
    for i in range(out.shape[0]):
        c = np.uint64(i)
        out[c] = min(max(heights[c] * ramp[0] + ramp[1], ramp[2]), ramp[3])


@kernel(fastmath=FAST)
def add_shapes(surface_mm, ramps, factors, out):
    """Write the surface (rows, cols) plus its shapes of `ramps` (n, 4), each times its factor."""
    rows, cols = surface_mm.shape
    for row in range(rows):
        r = np.uint64(row)
        for i in range(cols):
            c = np.uint64(i)
            height = surface_mm[r, c]
            total = height
            for a in range(ramps.shape[0]):
                ramp = ramps[a]
                total += factors[a] * min(max(height * ramp[0] + ramp[1], ramp[2]), ramp[3])
            out[r, c] = total
