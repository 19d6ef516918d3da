"""The scene of both sensors as a picture, and the press in motion as a film."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.core.arrays import Doubles, Image
from pipeline.core.figures import make_figure
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.graph import StageResults
from pipeline.core.values.frames import TactileFrame
from pipeline.sensors.alignment import correct_alignment
from pipeline.translation.translate import Translation
from pipeline.translation.truth_view import build_truth_view
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import Layer, ViewBounds, make_frame_layer
from pipeline.views.press_motion import DURATION_S, PressMotion
from pipeline.views.preview import make_recorded_preview
from pipeline.views.scene import (
    MEMBRANE_STAGES,
    ScenePlaces,
    compute_scene_bounds,
    find_scene_places,
    make_scene_layers,
)
from pipeline.views.scene_drawing import DARK_BACKGROUND, draw_scene, make_view

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILM_RATE_HZ = 12.5
DEFAULT_SIZE_PX = (960, 720)
DPI = 100
_FINER = 2  # scenes are drawn so many times as large, and averaged: smooth edges
_SWING_DEG = 14.0  # by which the view turns either way in a film
INK = "#e8ebf0"


@frozen
class FrameScene:
    """The scene of one frame."""

    layers: tuple[Layer, ...]
    motion: PressMotion
    places: ScenePlaces
    bounds: ViewBounds
    title: str

    def draw_film(self, size_px: tuple[int, int]) -> Iterator[Image]:
        """Yield the press in motion once, (rows, cols, 3) each; the end is the beginning."""
        figure, draw = self._lay_out(size_px)
        n_images = round(FILM_RATE_HZ * DURATION_S)
        for k in range(n_images):
            time = k / n_images
            draw(
                self.motion.make_layers(time),
                math.radians(_SWING_DEG) * math.sin(2.0 * math.pi * time),
                self.motion.describe(time),
            )
            canvas: Any = figure.canvas
            canvas.draw()
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def draw_figure(self, size_px: tuple[int, int]) -> Figure:
        """Return the scene as it is at the end of the press."""
        figure, draw = self._lay_out(size_px)
        draw(self.layers, 0.0, "")
        return figure

    def draw_image(self, size_px: tuple[int, int]) -> Image:
        """Return the scene alone, without a word."""
        return _draw_layers(self.layers, self.bounds, size_px)[0]

    def _lay_out(self, size_px: tuple[int, int]) -> tuple[Figure, Any]:
        """Return an empty figure, and what draws layers, a turn in rad and a text into it."""
        width, height = size_px
        figure = make_dark_figure(size_px)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        shown = axes.imshow(np.zeros((height, width, 3), np.uint8), aspect="auto")
        letters = {letter: axes.text(0, 0, letter, color=INK) for letter in self.places.labels}
        figure.text(0.015, 0.955, self.title, color=INK, fontsize=11)
        caption = figure.text(0.015, 0.03, "", color=INK, fontsize=10)

        def draw(layers: tuple[Layer, ...], turn_rad: float, text: str) -> None:
            image, camera, camera_from_scene = _draw_layers(
                layers, _turn(self.bounds, turn_rad), size_px
            )
            shown.set_data(image)
            for letter, place in self.places.labels.items():
                seen = rigid.apply(camera_from_scene, np.array([place]))
                x_px, y_px, _ = camera.project(seen)
                letters[letter].set_position((x_px[0] / _FINER + 5, y_px[0] / _FINER - 5))
            caption.set_text(text)

        return figure, draw


def make_dark_figure(size_px: tuple[int, int]) -> Figure:
    """Return an empty figure of this width and height on the background of scenes."""
    width, height = size_px
    figure = make_figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    figure.set_facecolor("#{:02x}{:02x}{:02x}".format(*DARK_BACKGROUND))
    return figure


def name_sensors(translation: Translation) -> str:
    """Return both sensors."""
    return f"{translation.source.title} \N{RIGHTWARDS ARROW} {translation.target.title}"


def make_frame_scene(
    frame: TactileFrame,
    results: StageResults,
    translation: Translation,
    display: DisplayParams,
) -> FrameScene:
    """Return the scene of a frame with these results, as the window shows it."""
    source, target = translation.source, translation.target
    context = translation.make_preview_context(results, display)
    picture, camera = make_recorded_preview(frame, source, display)
    shown: dict[str, tuple[Layer, ...]] = {}
    shown["source"] = (make_frame_layer("source", frame.image, camera, picture, source),)
    truths = translation.read_true_outputs(frame.index)
    recorded: tuple[Layer, ...] = ()
    for name, result in results.items():
        view = translation.catalogue.views[name]
        preview = view.make_preview(result.output, context)
        shown[name] = view.make_layers(result.output, context, preview)
        truth = build_truth_view(name, view, preview, truths, context)
        if name in MEMBRANE_STAGES and truth is not None:
            recorded = tuple(layer for layer in truth.layers if layer.name == name)
    motion = rigid.invert(translation.request.offsets.to_matrix())
    opened = correct_alignment(translation.alignment, motion)
    places = find_scene_places(opened, translation.alignment)
    layers = make_scene_layers(shown, source, target, places, recorded)
    words = (name_sensors(translation), f"frame {frame.index}", translation.truth_label)
    return FrameScene(
        layers=layers,
        motion=PressMotion(layers, source, target, places),
        places=places,
        bounds=compute_scene_bounds(source, target, opened),
        title=", ".join(filter(None, words)),
    )


def _draw_layers(
    layers: Sequence[Layer], bounds: ViewBounds, size_px: tuple[int, int]
) -> tuple[Image, Camera, Doubles]:
    """Return an image of layers, its camera, finer than the image, and camera_from_scene."""
    width, height = size_px
    camera, camera_from_scene = make_view(bounds, _FINER * width, _FINER * height)
    poses = {
        layer.name: camera_from_scene
        if layer.view_from_layer is None
        else camera_from_scene @ layer.view_from_layer
        for layer in layers
    }
    image = _shrink(draw_scene(layers, camera, poses, DARK_BACKGROUND))
    return image, camera, camera_from_scene


def _turn(bounds: ViewBounds, turn_rad: float) -> ViewBounds:
    """Return the view turned about what is up."""
    about_up = rigid.rotation(turn_rad * np.array(bounds.up))[:3, :3]
    x, y, z = (float(value) for value in about_up @ np.array(bounds.direction))
    return replace(bounds, direction=(x, y, z))


def _shrink(pixels: Image) -> Image:
    rows, cols = (n // _FINER for n in pixels.shape[:2])
    parts = pixels.reshape(rows, _FINER, cols, _FINER, 3)
    return parts.mean(axis=(1, 3)).astype(np.uint8)
