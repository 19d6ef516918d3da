"""Check the unit of depth images against the described rest depth: 1.5 times it is another
camera, 10 times a unit.
"""

import math

import numpy as np

from pipeline.sensors.spec import SensorSpec

_MAX_RATIO = 3.0  # between two cameras of one kind of sensor; a factor of ten is a unit
_FACTORS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)


def find_unit_factor(depth_mm: float, spec: SensorSpec) -> float:
    """The factor that a median depth lacks to fit the sensor's rest depth: 1 where it fits, NaN
    where no unit does.
    """
    rest_mm = float(np.median(spec.rest_depth_mm))
    if not depth_mm > 0.0:
        return math.nan
    distances = {factor: abs(math.log(depth_mm * factor / rest_mm)) for factor in (1.0, *_FACTORS)}
    factor = (
        1.0
        if distances[1.0] <= math.log(_MAX_RATIO)
        else min(distances, key=lambda f: distances[f])
    )
    return factor if distances[factor] <= math.log(_MAX_RATIO) else math.nan


def describe_unit_problem(depth_mm: float, spec: SensorSpec) -> str:
    """Why a median depth cannot be in millimetres, as a clause; "" where it may be."""
    factor = find_unit_factor(depth_mm, spec)
    if factor == 1.0 or math.isnan(factor):
        return ""
    times = f"{1 / factor:g} times too large" if factor < 1 else f"{factor:g} times too small"
    return (
        f"has a median depth of {depth_mm:.3g} mm, and the membrane of {spec.name} rests at "
        f"{np.median(spec.rest_depth_mm):.3g} mm: {times}, so its unit is another one"
    )
