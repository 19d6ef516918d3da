"""Membranes of simulated presses at known poses, as a perfect depth method would measure them."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from pipeline.core.geometry import rigid
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.poses import compute_lowest_mm
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor

GELSLIM = load_sensor("gelslim_dotless")


def pose(shape: str, x_mm=0.0, y_mm=0.0, angle_deg=0.0, depth_mm=0.5):
    mesh = shapes.make_shape(shape).mesh
    placed = rigid.translation(x_mm, y_mm, 0.0) @ rigid.rotation(
        (0.0, 0.0, math.radians(angle_deg))
    )
    placed[2, 3] = -depth_mm - compute_lowest_mm(
        rigid.apply(placed, mesh.vertices_mm), mesh.triangles
    )
    return placed


@lru_cache(maxsize=64)
def press(shape: str, x_mm=0.0, y_mm=0.0, angle_deg=0.0, sensor=GELSLIM.name):
    """(membrane, sensor_from_object) of a press."""
    spec = load_sensor(sensor)
    made = simulate_press(
        shapes.make_shape(shape).mesh, pose(shape, x_mm, y_mm, angle_deg), spec, seed=None
    )
    membrane = DepthMap(
        indentation_mm=made.indentation_mm,
        depth_mm=(spec.rest_depth_mm - made.indentation_mm).astype(np.float32),
        contact=made.contact,
        camera=spec.camera,
        source_index=make_pixel_index(made.contact.shape),
    )
    return membrane, made.sensor_from_object


def untouched():
    rest = GELSLIM.rest_depth_mm.astype(np.float32)
    return DepthMap(
        indentation_mm=np.zeros_like(rest),
        depth_mm=rest,
        contact=np.zeros(rest.shape, bool),
        camera=GELSLIM.camera,
        source_index=make_pixel_index(rest.shape),
    )
