"""Slots whose value is a `DepthMap`: the source's membrane and the target's are looked at alike."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.engine.graph import Method
from pipeline.evaluation.metrics import surface_figures
from pipeline.pictures.layers import Layer, membrane_layer, surface_layer
from pipeline.pictures.picture import Picture, of_heights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages import known_truth
from pipeline.stages.follow import element_of
from pipeline.stages.slot import Facts, Mark, Place, Seen, Slot
from pipeline.values.results import DepthMap


def reading(*, name: str, title: str, legend: str, place: Place, methods: tuple[Method, ...]) -> Slot:
    """The entry of a slot that holds how far the membrane of the sensor at `place` is pushed in."""

    def sensor(seen: Seen) -> SensorSpec:
        return seen.source if place == "source" else seen.target

    def picture(depth: DepthMap, seen: Seen) -> Picture:
        return of_heights(depth.indentation_mm, depth.depth_mm, depth.contact, depth.camera, sensor(seen), seen.display)

    def layers(depth: DepthMap, seen: Seen, picture: Picture) -> tuple[Layer, ...]:
        times = seen.display.stretch(sensor(seen))
        surface = surface_layer(name, depth.depth_mm, depth.indentation_mm, depth.camera, picture.pixels, times)
        return (surface,) if place == "source" else (surface, membrane_layer(seen.target))

    def follow(depth: DepthMap, before: Mark) -> Mark:
        index = element_of(depth.source_index, before.index)
        return _mark(name, depth, index) if index >= 0 else Mark(slot=name, index=-1, text="outside the depth map")

    def figures(depth: DepthMap, facts: Facts) -> Mapping[str, float]:
        truth = facts.source if place == "source" else facts.target
        return {} if truth is None else surface_figures(depth.indentation_mm, depth.contact, truth)

    def truth(facts: Facts, there: SensorSpec) -> DepthMap | None:
        return known_truth.membrane(facts, place, there)

    return Slot(
        name=name, title=title, legend=legend, place=place, methods=methods,
        picture=picture, layers=layers, follow=follow, figures=figures, truth=truth,
    )  # fmt: skip


def _mark(slot: str, depth: DepthMap, index: int) -> Mark:
    """Where a pixel lies on the membrane."""
    row, col = divmod(index, depth.camera.cols)
    value, z = float(depth.indentation_mm[row, col]), float(depth.depth_mm[row, col])
    ray_x, ray_y = depth.camera.rays()
    if not np.isfinite(value):
        text = "no depth reading here"
    elif not depth.contact[row, col]:
        text = f"{value:.3f} mm, not in contact"
    else:
        text = f"{value:.3f} mm"
    point = (float(ray_x[col]) * z, float(ray_y[row]) * z, z) if np.isfinite(z) else None
    return Mark(slot=slot, index=index, row=row, col=col, point_mm=point, text=text)
