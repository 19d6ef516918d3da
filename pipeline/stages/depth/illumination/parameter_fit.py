"""Fit of LED parameters to touches of one sensor instance by variable projection (Golub and Pereyra
1973).

Instances differ in their LEDs' positions and powers, in fall-off, lens and shadows: deviations t
from the description, with a prior covariance C. Whatever they are, the surface explains as much of
the image as it can; only what no surface explains determines t. A step dt changes that by D dt,
summed over all touches,

    D = T - J grad P(J^+ T),    dt = (sum D' W D / s^2 + C^-1)^-1 (sum D' W r / s^2 - C^-1 t)

with T, J the derivatives of the image by deviations and slopes, J^+ the slopes that explain a
change best, P the surface nearest to them by certainty, r the residual, W Huber's weights, and s
the noise of a colour. The power common to all LEDs is determined by slopes that are not small, and
by C. Several touches of one instance determine more than one: on simulated instances the light
fitted to eight is as good as the true one.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats
from pipeline.physics import optics
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import LIGHT, SURFACE
from pipeline.stages.depth.illumination.led_light import (
    LedLight,
    compute_led_prior_root,
    make_led_light,
    shift_optics,
)
from pipeline.stages.depth.illumination.light import (
    ImagePatch,
    RenderedChange,
    TouchObservation,
    blur_change,
    simulate_recorded_change,
    sum_change_grey,
)
from pipeline.stages.depth.illumination.surface_refinement import clip_surface, refine_surface
from pipeline.stages.depth.poisson import Integrator, solve_weighted_slopes


def fit_leds(source: SensorSpec, touches: Sequence[TouchObservation]) -> Doubles | None:
    """Deviations (m,) of the instance's LEDs (`led_light.shift_optics`).

    None where no usual instance explains them.

    Zero where the touches do not differ from the description.
    """
    root = compute_led_prior_root(optics.require_optics(source))
    precision = np.linalg.inv(root @ root.T)
    deviations = np.zeros(len(precision))
    normal = precision
    noise = 0.0
    change = 0.0
    for touch in touches:
        share = touch.patch.unmarked_share
        noise += LIGHT.misfit_noise_grey * float((share[..., 0] * touch.patch.changed).sum())
        change += sum_change_grey(touch.patch)
    for iteration in range(LIGHT.fit_iterations + 1):
        touches, misfit = _refine_surfaces(source, deviations, touches)
        excess = max(0.0, misfit - noise) / max(change, 1.0)
        score = (
            float(deviations @ precision @ deviations) / LIGHT.max_deviance
            + excess / LIGHT.max_excess
        )
        if score > LIGHT.hopeless[iteration]:
            return None
        if iteration < LIGHT.fit_iterations:
            systems = [_linearise(source, root, deviations, touch) for touch in touches]
            normal = precision + sum(system[0] for system in systems)
            step = np.linalg.solve(
                normal, sum(system[1] for system in systems) - precision @ deviations
            )
            length = math.sqrt(float(step @ precision @ step))
            deviations = deviations + step * min(1.0, LIGHT.max_fit_step / max(length, 1e-9))
    determined = float(np.trace(np.linalg.solve(normal, normal - precision)))
    is_as_described = float(deviations @ precision @ deviations) < LIGHT.as_described * determined
    return np.zeros_like(deviations) if is_as_described else deviations


def _make_light(source: SensorSpec, deviations: Doubles, patch: ImagePatch) -> LedLight:
    shifted = shift_optics(optics.require_optics(source), deviations)
    return make_led_light(source, shifted, patch, trusted=True)


def _refine_surfaces(
    source: SensorSpec, deviations: Doubles, touches: Sequence[TouchObservation]
) -> tuple[list[TouchObservation], float]:
    """The touches with their surfaces refined in this light, and the sum of their misfits."""
    refined = list[TouchObservation]()
    total = 0.0
    for touch in touches:
        surface, misfit = refine_surface(
            touch.surface_mm,
            touch.patch,
            _make_light(source, deviations, touch.patch),
            touch.integrate,
            LIGHT.fit_refinements,
            replace(SURFACE, cg_steps=LIGHT.fit_cg_steps),
        )
        refined.append(replace(touch, surface_mm=surface))
        total += misfit
    return refined, total


def _linearise(
    source: SensorSpec, root: Doubles, deviations: Doubles, touch: TouchObservation
) -> tuple[Doubles, Doubles]:
    """The normal equations (m, m), (m,) of the deviations, from what no change of the surface
    explains.
    """
    patch = touch.patch
    light = _make_light(source, deviations, patch)
    surface = clip_surface(touch.surface_mm, patch, light, SURFACE.bulge_mm)
    slopes = compute_slopes(surface, patch.pixel_mm)
    rendered = light.render(surface, *slopes)
    residual = patch.change - simulate_recorded_change(rendered.change, patch, light.blur_px)
    weight = _compute_colour_weights(residual, patch) * patch.unmarked_share**2
    blurred = blur_change(rendered.change, patch, light.blur_px)
    columns = np.zeros((len(deviations), *blurred.shape), np.float32)
    sizes = LIGHT.rate_step * np.sqrt((root**2).sum(axis=1))
    for k, size in enumerate(sizes):
        shifted = deviations.copy()
        shifted[k] += size
        other = _make_light(source, shifted, patch)
        if other.optics == light.optics:  # this sensor's light does not depend on it
            continue
        columns[k] = (
            blur_change(other.render(surface, *slopes).change, patch, other.blur_px) - blurred
        )
        columns[k] /= np.float32(size)
    _project_out_surface(columns, rendered, weight, patch, touch.integrate)
    flat = columns.reshape(len(deviations), -1).astype(np.float64)
    share = (
        min(1.0, LIGHT.independent_pixels / max(1, np.count_nonzero(patch.changed)))
        / LIGHT.noise_grey**2
    )
    weighted = flat * (share * weight.ravel().astype(np.float64))
    return weighted @ flat.T, weighted @ residual.ravel()


def _compute_colour_weights(residual: Floats, patch: ImagePatch) -> Floats:
    """Huber's weights (rows, cols, 3) of the residuals; 0 where the camera is clipped."""
    image = patch.reference + patch.change
    huber = np.float32(SURFACE.huber_grey)
    informative = (image > LIGHT.black_grey) & (image < LIGHT.white_grey) & patch.changed[..., None]
    return np.asarray(
        informative * np.minimum(1.0, huber / np.maximum(np.abs(residual), huber)), np.float32
    )


def _project_out_surface(
    columns: Floats,
    rendered: RenderedChange,
    weight: Floats,
    patch: ImagePatch,
    integrate: Integrator,
) -> None:
    """Subtract from `columns` (m, rows, cols, 3), changes of an image, what the best surface
    explains of each.
    """
    _, across, down = rendered
    pull = np.float32(SURFACE.trusted_step.pull)
    outside = np.float32(SURFACE.outside_weight)
    xx = _sum(weight, across, across) + pull
    xy = _sum(weight, across, down)
    yy = _sum(weight, down, down) + pull
    weights = np.where(
        patch.changed, np.stack([xx, xy, yy]), np.array([outside, 0.0, outside])[:, None, None]
    )
    per = patch.changed / (xx * yy - xy * xy)
    to_x, to_y = (
        per * np.einsum("rck,rck,nrck->nrc", weight, rates, columns) for rates in (across, down)
    )
    target = _single(yy * to_x - xy * to_y), _single(xx * to_y - xy * to_x)
    flat = np.zeros_like(target[0])
    steps = LIGHT.projection_cg_steps
    bent = (
        solve_weighted_slopes(flat, target, _single(weights), patch.pixel_mm, integrate, steps)
        * patch.changed
    )
    for rates, slopes in zip((across, down), compute_slopes(bent, patch.pixel_mm), strict=True):
        columns -= rates * slopes[..., None]


def _single(field: NDArray[np.floating]) -> Floats:
    return np.asarray(field, np.float32)


def _sum(weight: Floats, a: Floats, b: Floats) -> Floats:
    """Weighted sum over the colours of each pixel (rows, cols)."""
    return _single(np.einsum("rck,rck,rck->rc", weight, a, b))
