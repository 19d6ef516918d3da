"""The kind "bubble": a depth camera watches an inflated membrane."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze
from pipeline.geometry import membrane
from pipeline.geometry.camera import Camera
from pipeline.geometry.membrane import Membrane
from pipeline.sensors.kinds import GetSection, SensorKind
from pipeline.sensors.parts import Bubble, DepthCamera, parse_part

if TYPE_CHECKING:
    from pipeline.sensors.spec import SensorSpec


def parse_parts(section: GetSection, data: dict[str, Any], _path: Path) -> dict[str, Any]:
    """[bubble] and [depth_camera]."""
    depth_camera = parse_part(DepthCamera, section("depth_camera")) if "depth_camera" in data else DepthCamera()
    return {"bubble": parse_part(Bubble, section("bubble")), "depth_camera": depth_camera}


def parse_membrane(section: GetSection, _camera: Camera, parts: dict[str, Any]) -> Membrane:
    """A dome over the rim at the depth of [rest]."""
    bubble: Bubble = parts["bubble"]
    rim_mm = section("rest").read_number("rim_depth", "mm", 1.0, 1000.0)
    return membrane.make_dome_membrane(rim_mm, bubble.height_mm, bubble.half_width_mm, bubble.half_height_mm)


def render_reference(sensor: SensorSpec) -> Floats:
    """The rest depth (rows, cols) float32 mm."""
    return freeze(sensor.rest_depth_mm.astype(np.float32))


def find_image_problem(image: NDArray[Any]) -> str:
    """Why a depth image (rows, cols) cannot be used, as a clause; "" where it can."""
    if not np.issubdtype(image.dtype, np.floating):
        return f"is {image.dtype}; a bubble's depth must be float32 in millimetres"
    if not (image > 0).any():
        return "holds no depth at all (NaN or zero everywhere); leave this frame out"
    return ""


BUBBLE = SensorKind(
    key="bubble",
    is_depth=True,
    change_sign=-1.0,
    full_change=1.0,
    peak_change=22.5,  # mm, as published
    display_group="bubble",
    still_change=0.4,
    drift_change=1.0,
    part_parser=f"{__name__}:parse_parts",
    membrane_parser=f"{__name__}:parse_membrane",
    reference_renderer=f"{__name__}:render_reference",
    image_checker=f"{__name__}:find_image_problem",
    contact_checker="pipeline.stages.depth.bubble_depth:describe_if_no_contact",
    depth_estimator="pipeline.stages.depth.photometric:estimate_bubble_frame",
    touch_renderer="pipeline.stages.touch.physical_render:render_bubble_touch",
    press_simulator="pipeline.simulation.press:simulate_bubble_press",
    image_simulator="pipeline.simulation.press:simulate_bubble_image",
    force_estimator="pipeline.physics.contact_force:estimate_bubble_force",
    touch_format="pipeline.networks.touch_formats:BUBBLE",
)
