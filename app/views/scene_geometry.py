"""What the 3D views show around their layers: bounds, probe points, captions and cameras by
name.
"""

import math
from collections.abc import Iterable
from html import escape

import numpy as np
from PyQt6.QtGui import QGuiApplication

from app.window.main_window import MainWindow
from pipeline.core.geometry import rigid
from pipeline.sensors.spec import SensorSpec
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation
from pipeline.views.colours import SOURCE_COLOUR, TARGET_COLOUR, Rgb
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import ViewBounds, stretch_depth
from pipeline.views.view import ProbePoint, to_xyz
from widgets.style.theme import get_theme_colours, to_hex
from widgets.views.view_3d_panel import View3DPanel

_MARGIN = 1.4  # radius of the target's view, in radii of the source's, if the source is a gel


def compute_view_bounds(translation: Translation) -> dict[str, ViewBounds]:
    """Return column -> bounds of its 3D view: the source, or the part of the target that the
    source can touch.
    """
    source = translation.source
    target = translation.target
    z = float(np.median(source.rest_depth_mm))
    radius = _radius_mm(source)
    at_source = ViewBounds(centre_mm=(0.0, 0.0, z), radius_mm=radius, frame=source.name)
    centre = to_xyz(rigid.apply(translation.alignment.target_from_source, (0.0, 0.0, z)))
    reach = (
        min(_radius_mm(target), _MARGIN * radius) if source.gel is not None else _radius_mm(target)
    )
    at_target = ViewBounds(centre_mm=centre, radius_mm=reach, frame=f"target {target.name}")
    places = {
        stage.name: at_source if stage.sensor_role == "source" else at_target
        for stage in translation.catalogue.stages
    }
    return {SOURCE: at_source, **places}


def compute_trace_points(
    points: Iterable[ProbePoint], translation: Translation, display: DisplayParams
) -> dict[str, tuple[float, float, float]]:
    """Return column -> x, y, z in mm of the probed pixel on the drawn (stretched) surface.

    Missing if not there.
    """
    positions: dict[str, tuple[float, float, float]] = {}
    for point in points:
        if point.point_mm is None or point.stage == SOURCE:
            continue
        sensor = translation.get_sensor(point.stage)
        stretch = get_depth_stretch(point.stage, translation, display)
        positions[point.stage] = _stretch_point(point.point_mm, sensor, stretch)
        # gel images lie on the rest surface, bubble images on the measured one
        if sensor is translation.source:
            positions[SOURCE] = _stretch_point(
                point.point_mm, sensor, 1.0 if sensor.sensor_kind.is_depth else 0.0
            )
    return positions


def get_depth_stretch(column: str, translation: Translation, display: DisplayParams) -> float:
    """Return by how much the 3D view of a column exaggerates indentations."""
    is_stretched = column != SOURCE and translation.catalogue.views[column].exaggerates_indentation
    return display.get_depth_stretch(translation.get_sensor(column)) if is_stretched else 1.0


def _stretch_point(
    point_mm: tuple[float, float, float], sensor: SensorSpec, stretch: float
) -> tuple[float, float, float]:
    return to_xyz(stretch_depth(np.array([point_mm], dtype=np.float32), sensor, stretch)[0])


def _radius_mm(sensor: SensorSpec) -> float:
    z = float(np.median(sensor.rest_depth_mm))
    camera = sensor.camera
    return 0.5 * math.hypot(camera.cols * z / camera.fx_px, camera.rows * z / camera.fy_px)


_TIMES = "\N{MULTIPLICATION SIGN}"
_SOURCE_LEGEND = "image on the sensor surface"


def show_captions(window: MainWindow, opened: Translation, display: DisplayParams) -> None:
    """Update the captions, with the axes in the colours of the theme."""
    _show_caption(window.view_panels["source"], _SOURCE_LEGEND, opened.source.title, 1.0)
    for stage in opened.catalogue.stages:
        stretch = get_depth_stretch(stage.name, opened, display)
        _show_caption(
            window.view_panels[stage.name],
            opened.catalogue.views[stage.name].legend,
            opened.get_sensor(stage.name).title,
            stretch,
        )


def show_scene_caption(
    window: MainWindow, opened: Translation, display: DisplayParams, motion: str = ""
) -> None:
    """Update what is written under the scene: the sensors in the colours of their cameras, and
    the `motion` in place of frame and axes.
    """
    window.scene_panel.sensors.set_texts(
        *(
            f"{_colour(f'S {source}', SOURCE_COLOUR)} {_colour(f'T {target}', TARGET_COLOUR)}"
            for source, target in (
                (opened.source.title, opened.target.title),
                ("source", "target"),
            )
        )
    )
    stretch = get_depth_stretch("touch_depth", opened, display)
    captions = (motion,) if motion else _format_captions("alignment", stretch)
    window.scene_panel.caption.set_texts(*captions)


def _colour(text: str, colour: Rgb) -> str:
    return f"<b style='color:{to_hex(colour)}'>{escape(text)}</b>"


def _show_caption(panel: View3DPanel, legend: str, frame: str, stretch: float) -> None:
    panel.legend.setText(legend)
    panel.legend.setToolTip(legend)
    panel.caption.set_texts(*_format_captions(frame, stretch))


def _format_captions(frame: str, stretch: float) -> tuple[str, str, str]:
    """Return frame, axes and depth stretch at three lengths, from full to shortest."""
    stretched = "" if stretch == 1.0 else f"{_TIMES}{stretch:g}"
    end = f", depth {stretched}" if stretched else ""
    frame = escape(frame)
    return (
        f"{frame} frame {_format_axes()}{end}",
        f"{frame} {_format_axes()} {stretched}".rstrip(),
        f"{_format_axes()} {stretched}".rstrip(),
    )


def _format_axes() -> str:
    colours = zip("xyz", get_theme_colours(QGuiApplication.palette()).axes, strict=True)
    return " ".join(_colour(name, colour) for name, colour in colours)
