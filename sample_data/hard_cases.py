"""Samples without contact, and with touches that are hard to estimate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.physics.simulation import shapes
from pipeline.sensors.parts import Glow
from pipeline.sensors.spec import SensorSpec, load_sensor
from sample_data.writing import PressFrame, write_recording

HOVER_MM = 20.0  # above the gels, also out of reach of the bubble
EXPOSURE_FACTOR = 1.6  # of the saturated frame
TROUBLE_NOTES = (
    "simulated: a hexagon frame, which a turn by 60 degrees maps to itself: poses that differ by "
    "such a turn are equal",
    "frame 0: nothing touches",
    "frame 1: a slack contact, so light that the gel hardly shows it",
    "frame 2: deep; the bubble bridges the middle of the frame without touching it",
    "frame 3: the GelSlim is exposed too long, and many of its pixels are saturated",
    "frame 4: the contact reaches beyond the GelSlim's picture",
    "frames 5 and 6: the same press, turned by 60 degrees: no sensor can tell them apart but by "
    "its noise",
)


def make_no_contact(path: Path) -> None:
    """Write three frames of three sensors with an object above them."""
    sensors = tuple(load_sensor(name) for name in ("gelslim", "digit", "soft_bubble"))
    frames = [
        PressFrame(pose=rigid.translation(0.0, 0.0, HOVER_MM + k), sensors=sensors)
        for k in range(3)
    ]
    write_recording(
        path,
        shapes.make_shape("notched_elbow"),
        frames,
        ("simulated: nothing touches in any frame",),
    )


def make_trouble(path: Path) -> None:
    """Write seven frames of a GelSlim and a Soft Bubble, each with another difficulty."""
    gel = load_sensor("gelslim")
    bubble = load_sensor("soft_bubble")
    good = (gel, bubble)
    saturated = (overexpose_sensor(gel), bubble)
    frames = (
        PressFrame(pose=rigid.translation(0.0, 0.0, HOVER_MM), sensors=good),
        PressFrame(pose=_place_object(-0.05), sensors=good),
        PressFrame(pose=_place_object(-1.0, x_mm=1.0), sensors=good),
        PressFrame(pose=_place_object(-0.6, x_mm=-1.0), sensors=saturated),
        PressFrame(pose=_place_object(-0.6, x_mm=7.0, y_mm=-3.0, rotation_deg=20.0), sensors=good),
        PressFrame(pose=_place_object(-0.6, rotation_deg=10.0), sensors=good),
        PressFrame(pose=_place_object(-0.6, rotation_deg=70.0), sensors=good),
    )
    write_recording(path, shapes.make_shape("hexagon"), frames, TROUBLE_NOTES)


def overexpose_sensor(spec: SensorSpec) -> SensorSpec:
    """Copy of the sensor with light `EXPOSURE_FACTOR` times as strong."""
    optics = spec.optics
    assert optics is not None

    def brighten(rgb: tuple[float, float, float]) -> tuple[float, float, float]:
        return (EXPOSURE_FACTOR * rgb[0], EXPOSURE_FACTOR * rgb[1], EXPOSURE_FACTOR * rgb[2])

    glows: tuple[Glow, ...] = tuple(replace(glow, rgb=brighten(glow.rgb)) for glow in optics.glows)
    leds = tuple(replace(led, rgb=brighten(led.rgb)) for led in optics.leds)
    return replace(
        spec, optics=replace(optics, base_rgb=brighten(optics.base_rgb), leds=leds, glows=glows)
    )


def _place_object(
    face_z_mm: float, *, x_mm: float = 0.0, y_mm: float = 0.0, rotation_deg: float = 0.0
) -> Doubles:
    return rigid.translation(x_mm, y_mm, face_z_mm) @ rigid.rotation(
        (0.0, 0.0, np.deg2rad(rotation_deg))
    )
