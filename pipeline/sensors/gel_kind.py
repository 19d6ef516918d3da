"""The kind "gel": a camera watches the coloured light on an elastic layer."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry import membrane
from pipeline.geometry.camera import Camera
from pipeline.geometry.membrane import Membrane
from pipeline.sensors.kinds import GetSection, SensorKind
from pipeline.sensors.parts import Gel, parse_optics, parse_part

_BLACK_GREY = 2  # grey level; no lit gel is this dark everywhere
_WHITE_GREY = 254  # grey level; no gel is this bright everywhere, noise takes clipped pixels down to here


def parse_parts(section: GetSection, data: dict[str, Any], path: Path) -> dict[str, Any]:
    """[gel] and [optics]."""
    return {"gel": parse_part(Gel, section("gel")), "optics": parse_optics(section("optics"), data, path)}


def parse_membrane(section: GetSection, camera: Camera, _parts: dict[str, Any]) -> Membrane:
    """A flat membrane at the depth of [rest] that fills the image."""
    z_mm = section("rest").read_number("depth", "mm", 0.1, 1000.0)
    return membrane.make_flat_membrane(z_mm, camera.cols * z_mm / camera.fx_px, camera.rows * z_mm / camera.fy_px)


def find_image_problem(image: NDArray[Any]) -> str:
    """Why an image (rows, cols, 3) cannot be used, as a clause; "" where it can."""
    if image.dtype != np.uint8:
        is_nan = np.issubdtype(image.dtype, np.floating) and not np.isfinite(image).all()
        what = "holds values that are not numbers (NaN)" if is_nan else f"is {image.dtype}"
        return f"{what}; a gel's image must be RGB of 8 bits"
    if int(image.max()) <= _BLACK_GREY:
        return "is black; check the light and the camera, or leave this frame out"
    if int(image.min()) >= _WHITE_GREY:
        return "is clipped in every pixel and shows nothing of the gel; reduce the exposure, or leave this frame out"
    return ""


GEL = SensorKind(
    key="gel",
    is_depth=False,
    change_sign=1.0,
    full_change=255.0,
    peak_change=255.0,
    display_group="gel",
    still_change=2.0,
    drift_change=None,
    part_parser=f"{__name__}:parse_parts",
    membrane_parser=f"{__name__}:parse_membrane",
    reference_renderer="pipeline.physics.optics:render_reference",
    image_checker=f"{__name__}:find_image_problem",
    contact_checker="",
    depth_estimator="",
    touch_renderer="pipeline.stages.touch.physical_render:render_gel_touch",
    press_simulator="pipeline.simulation.press:simulate_gel_press",
    image_simulator="pipeline.simulation.press:simulate_gel_image",
    force_estimator="pipeline.stages.depth.gel_force:estimate_gel_force",
    touch_format="pipeline.networks.touch_formats:GEL",
)
